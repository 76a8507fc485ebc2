"""The replay buffer: transitions with masks packed to bits, and SDFs when they are sampled.

An SDF of 96 x 96 pixels takes 37 kB, its mask 1.2 kB; and the goal is the same before and after
a push. So a buffer of 20,000 transitions of three objects takes 200 MB instead of 7 GB, and a few
megabytes in a compressed checkpoint.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers import RandomSampler
from torchrl.envs.transforms import Transform

from sdfgcn.config import Config
from sdfgcn.perception.sdf import SdfCache
from sdfgcn.train.mirror import MirrorTransform

GOAL_KEYS = ("goal_sdf", "goal_node_mask", "goal_center", "goal_position")
SCENE_KEYS = ("sdf", "node_mask", "center", "position", "correspondence", "action_mask")
OUTCOME_KEYS = ("reward", "terminated", "done")

# Where SDFs stand in a transition, and the node mask that belongs to each.
_SDFS: tuple[tuple[Any, Any], ...] = (
    ("sdf", "node_mask"),
    ("goal_sdf", "goal_node_mask"),
    (("next", "sdf"), ("next", "node_mask")),
)


class PackMasks(Transform):
    """Packs SDFs to the bits of their masks on the way in, and restores them on the way out.

    On the way out the goal is copied into "next", where the loss looks for it.
    """

    def __init__(self, cache: SdfCache, image_size: int) -> None:
        """Make the transform.

        Args:
            cache: Gets the SDFs that come in, and gives those that go out.
            image_size: H and W.
        """
        super().__init__()
        self._cache = cache
        self._size = image_size

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        packed = tensordict.exclude(*(sdf for sdf, _ in _SDFS))
        for sdf, nodes in _SDFS:
            packed[sdf] = self._pack(tensordict[sdf], tensordict[nodes])
        return packed

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Restore [B, N, H, W] float32 SDFs from [B, N, H * W / 8] bits."""
        restored = tensordict.copy()
        for sdf, nodes in _SDFS:
            restored[sdf] = self._unpack(tensordict[sdf], tensordict[nodes])
        for key in GOAL_KEYS:
            restored["next", key] = restored[key]
        return restored

    def _pack(self, sdf: Tensor, nodes: Tensor) -> Tensor:
        fields = sdf.numpy()
        bits = np.packbits((fields < 0.0).reshape(*fields.shape[:-2], -1), axis=-1)
        for row in zip(*np.nonzero(nodes.numpy()), strict=True):
            self._cache.put(bits[row].tobytes(), fields[row])
        return torch.from_numpy(bits)

    def _unpack(self, bits: Tensor, nodes: Tensor) -> Tensor:
        packed = bits.numpy()
        fields = np.zeros((*packed.shape[:-1], self._size, self._size), dtype=np.float32)
        for row in zip(*np.nonzero(nodes.numpy()), strict=True):
            fields[row] = self._cache.get(packed[row].tobytes())
        return torch.from_numpy(fields)


def transitions(collected: TensorDictBase) -> TensorDict:
    """What a replay buffer keeps of collected pushes: no key that follows from others.

    Args:
        collected: [T] as a collector hands it over.
    """
    kept = collected.select(*SCENE_KEYS, *GOAL_KEYS, "action")
    kept["next"] = collected["next"].select(*SCENE_KEYS, *OUTCOME_KEYS)
    return kept


def build_replay(config: Config) -> ReplayBuffer:
    """An empty replay buffer with the transforms that the config asks for.

    It takes what `transitions` returns, [T], and gives batches [B] that a DQN loss understands.
    """
    size = config.env.arena.image_size
    cache = SdfCache(config.train.sdf_cache, (size, size), config.env.perception.sdf)
    replay = ReplayBuffer(
        storage=LazyTensorStorage(config.train.replay_capacity),
        sampler=RandomSampler(),
        batch_size=config.train.batch_size,
    )
    filled = _Filled(replay)
    replay.register_save_hook(filled.cut)
    replay.register_load_hook(filled.padded)
    replay.append_transform(PackMasks(cache, size))
    if config.augment.name == "mirror":
        replay.append_transform(MirrorTransform(config.augment.probability))
    return replay


class _Filled:
    """Lets a checkpoint hold the filled part of a buffer alone."""

    def __init__(self, replay: ReplayBuffer) -> None:
        self._replay = replay

    def cut(self, data: TensorDictBase, path: Path) -> TensorDictBase:
        return data[: len(self._replay)]

    def padded(self, data: TensorDictBase, out: TensorDictBase | None) -> TensorDictBase:
        capacity = self._replay.storage.max_size
        whole = data[:1].expand(capacity).clone()
        whole[: len(data)] = data
        return whole
