"""The mirror symmetry of the table (`augment=mirror`).

The camera is in the plane x = 0 and every region is symmetric about it, so a transition mirrored in
that plane is also possible. Mirroring is exact except for fast marching, which breaks ties by pixel
order: the SDF of a mirrored mask differs from the mirrored SDF by up to 0.3 pixels.
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
        transition: Of any batch shape: an observation, with or without `action` and "next". Not
            modified.
        push_space: Mirrors actions.
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
    """Mirrors each sampled transition with a given probability."""

    def __init__(self, probability: float, push_space: PushSpace) -> None:
        """Make the transform.

        Args:
            probability: Per transition; drawn from torch's generator, like the sample itself.
            push_space: Mirrors actions.
        """
        super().__init__()
        self._probability = probability
        self._push_space = push_space

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Mirror a random subset of the [B] transitions."""
        chosen = torch.rand(tensordict.batch_size) < self._probability
        result = tensordict.clone()
        if chosen.any():
            result[chosen] = mirrored(tensordict[chosen], self._push_space)
        return result
