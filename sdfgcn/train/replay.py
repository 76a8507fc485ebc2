"""The replay buffer: transitions are stored with masks packed into bits and sampled with SDFs.

An SDF of 96 x 96 pixels takes 37 kB, its mask 1.2 kB, and the goal is the same before and after a
push. So a buffer of 20,000 transitions of three objects takes 200 MB instead of 7 GB, and a few
megabytes in a compressed checkpoint.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from tensordict import TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers import RandomSampler
from torchrl.envs.transforms import Transform

from sdfgcn.config import Config
from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.task.push_space import PushSpace
from sdfgcn.task.scene import Scene
from sdfgcn.train.mirror import MirrorTransform


class Replay:
    """The buffer: `stored` converts pushes to transitions, `extend` adds them, `sample` draws."""

    def __init__(self, config: Config) -> None:
        """Make an empty buffer with the transforms that the config asks for."""
        train, env = config.train, config.train.env
        self._sdf = SdfTransform(
            env.perception.sdf, env.arena.image_size, train.sdf_cache, np.float16
        )
        self.buffer = ReplayBuffer(
            storage=LazyTensorStorage(train.replay_capacity),
            sampler=RandomSampler(),
            batch_size=train.batch_size,
        )
        filled = _Filled(self.buffer)
        self.buffer.register_save_hook(filled.cut)
        self.buffer.register_load_hook(filled.padded)
        self.buffer.append_transform(_Unpack(self._sdf))
        if config.augment.name == "mirror":
            push_space = PushSpace(env.push, env.arena)
            self.buffer.append_transform(MirrorTransform(config.augment.probability, push_space))

    def __len__(self) -> int:
        """The number of transitions held."""
        return len(self.buffer)

    def stored(self, collected: TensorDictBase) -> TensorDictBase:
        """Convert [T] pushes from a collector to the form in which they are stored.

        Observation, action and outcome, with mask bits instead of SDFs; the next observation's
        goal is dropped, as it is the same.
        """
        outcome = collected["next"].exclude("goal")
        kept = collected.select(*collected["next"].keys(), "action", strict=False)
        return _scenes_changed(
            kept.set("next", outcome), lambda scene: scene.packed(self._sdf.pack)
        )

    def extend(self, transitions: TensorDictBase | None) -> None:
        """Add transitions in the form that `stored` returns; None adds nothing."""
        if transitions is not None:
            self.buffer.extend(transitions)

    def sample(self) -> TensorDictBase:
        """Draw a batch [B] in the form that the DQN loss expects."""
        return self.buffer.sample()


class _Unpack(Transform):
    """Restores SDFs from bits, and copies the goal to "next", where the loss expects it."""

    def __init__(self, sdf: SdfTransform) -> None:
        super().__init__()
        self._sdf = sdf

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        restored = _scenes_changed(tensordict, lambda scene: scene.unpacked(self._sdf.unpack))
        restored["next", "goal"] = restored["goal"]
        return restored


def _scenes_changed(
    transitions: TensorDictBase, change: Callable[[Scene], Scene]
) -> TensorDictBase:
    """A copy with `change` applied to every scene, at any depth."""
    result = transitions.copy()
    for key, value in transitions.items():
        if isinstance(value, Scene):
            result[key] = change(value)
        elif isinstance(value, TensorDictBase):
            result[key] = _scenes_changed(value, change)
    return result


class _Filled:
    """Save and load hooks that keep only the filled part of a buffer in a checkpoint."""

    def __init__(self, replay: ReplayBuffer) -> None:
        self._replay = replay

    def cut(self, data: TensorDictBase, path: Path) -> TensorDictBase:
        return data[: len(self._replay)]

    def padded(self, data: TensorDictBase, out: TensorDictBase | None) -> TensorDictBase:
        capacity = self._replay.storage.max_size
        whole = data[:1].expand(capacity).clone()
        whole[: len(data)] = data
        return whole
