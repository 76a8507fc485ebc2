"""The mirror symmetry of the table (`augment=mirror`).

The camera stands in the plane x = 0 and every region is symmetric to it. So a transition mirrored
at that plane is one that could have happened. It is exact but for fast marching, which breaks ties
in the order of the pixels: an SDF of the mirrored mask differs by up to 0.3 pixels.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torchrl.envs.transforms import Transform

from sdfgcn.task.push_space import PushSpace
from sdfgcn.task.scene import Scene


def mirrored(transition: TensorDictBase, push_space: PushSpace) -> TensorDictBase:
    """Mirror transitions or observations from left to right.

    Args:
        transition: Any batch shape: an observation, with or without `action` and "next". Left as
            it is.
        push_space: Says what becomes of an action.
    """
    result = transition.copy()
    for key, value in transition.items():
        if isinstance(value, Scene):
            result[key] = value.mirrored()
        elif isinstance(value, TensorDictBase):
            result[key] = mirrored(value, push_space)
        elif key == "action_mask":
            result[key] = push_space.mirrored(value)
        elif key == "action":
            result[key] = push_space.mirrored_action(value)
    return result


class MirrorTransform(Transform):
    """Mirrors each sampled transition with some probability."""

    def __init__(self, probability: float, push_space: PushSpace) -> None:
        """Make the transform.

        Args:
            probability: Of each transition, drawn from torch's generator like the sample itself.
            push_space: Says what becomes of an action.
        """
        super().__init__()
        self._probability = probability
        self._push_space = push_space

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Mirror some of the [B] transitions."""
        chosen = torch.rand(tensordict.batch_size) < self._probability
        result = tensordict.clone()
        if chosen.any():
            result[chosen] = mirrored(tensordict[chosen], self._push_space)
        return result
