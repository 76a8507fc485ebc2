"""The replay buffer: transitions are stored with masks packed into bits and sampled with SDFs.

An SDF of 96 x 96 pixels takes 37 kB, its mask 1.2 kB, and the goal is the same before and after a
push. So a buffer of 20,000 transitions of three objects takes 200 MB instead of 7 GB, and a few
megabytes in a compressed checkpoint.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers import RandomSampler
from torchrl.envs.transforms import Transform

from sdfgcn.config import Config, EnvConfig
from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.task.push_space import PushSpace
from sdfgcn.task.scene import Scene
from sdfgcn.train.collectors import TrainingEnv
from sdfgcn.train.mirror import MirrorTransform

# How much larger than expected transitions may be, for fields that an env of one's own adds.
MARGIN = 2
_FLAGS_BYTES = 128  # reward, flags and counters of an observation


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
        self._capacity, self._transition_bytes = train.replay_capacity, _transition_bytes(env)
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

    def state_dict(self) -> dict[str, Any]:
        """The transitions held and the place of the next one, for a checkpoint."""
        held = self.buffer.storage.get(slice(0, len(self))) if len(self) else None
        return {"transitions": held, "writer": self.buffer.writer.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state from a checkpoint.

        Raises:
            ValueError: The state is not of a buffer of this config.
        """
        held, writer = state["transitions"], state["writer"]
        if held is not None:
            # The buffer takes memory for as many of them as it can hold.
            size = sum(value.nbytes for value in held.values(True, True)) / max(len(held), 1)
            if len(held) > self._capacity or size > MARGIN * self._transition_bytes:
                raise ValueError(f"{len(held)} transitions of {size:.0f} bytes")
            self.extend(held)
        if not 0 <= writer["_cursor"] < self._capacity:
            raise ValueError(f"a cursor at {writer['_cursor']}")
        self.buffer.writer.load_state_dict(writer)

    @property
    def largest(self) -> int:
        """Bytes of a full buffer, with a margin."""
        return MARGIN * self._capacity * self._transition_bytes


class _Unpack(Transform):
    """Restores SDFs from bits, and copies the goal to "next", where the loss expects it."""

    def __init__(self, sdf: SdfTransform) -> None:
        super().__init__()
        self._sdf = sdf

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        restored = _scenes_changed(tensordict, lambda scene: scene.unpacked(self._sdf.unpack))
        restored["next", "goal"] = restored["goal"]
        return restored


def _transition_bytes(env: EnvConfig) -> int:
    """Bytes of a stored transition: three scenes, and what an observation has besides, twice."""
    n, size = env.max_objects, env.arena.image_size
    row = sum(
        size**2 // 8 if field.as_mask else math.prod(field.shape(size)) * field.dtype.itemsize
        for field in TrainingEnv.scene_type.declared().values()
    )
    rest = n * (env.push.directions + 1)  # the action mask and `matched`, a byte each
    return 3 * n * row + 2 * (rest + _FLAGS_BYTES)


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
