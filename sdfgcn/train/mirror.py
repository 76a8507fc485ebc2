"""The mirror symmetry of the table (`augment=mirror`).

The camera stands in the plane x = 0 and every region is symmetric to it. So a transition mirrored
at that plane is one that could have happened. It is exact but for fast marching, which breaks ties
in the order of the pixels: an SDF of the mirrored mask differs by up to 0.1 pixels.
"""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs.transforms import Transform

from sdfgcn.config import N_DIRECTIONS

# Direction k heads 45 k degrees from the x axis, its mirror image 180 - 45 k.
MIRRORED_DIRECTION = torch.tensor([(4 - k) % N_DIRECTIONS for k in range(N_DIRECTIONS)])

_PICTURES = ("sdf", "goal_sdf")
_POINTS = ("center", "goal_center", "position", "goal_position")


def mirrored(transition: TensorDictBase) -> TensorDictBase:
    """Mirror transitions or observations from left to right.

    Args:
        transition: Any batch shape; keys of an observation, `action`, and both under "next",
            whichever are there. Left as it is.
    """
    result = transition.copy()
    for part in (result, result.get("next", None)):
        if part is not None:
            _mirror_(part)
    return result


class MirrorTransform(Transform):
    """Mirrors each sampled transition with some probability."""

    def __init__(self, probability: float) -> None:
        """Make the transform.

        Args:
            probability: Of each transition, drawn from torch's generator like the sample itself.
        """
        super().__init__()
        self._probability = probability

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Mirror some of the [B] transitions."""
        chosen = torch.rand(tensordict.batch_size) < self._probability
        result = tensordict.clone()
        if chosen.any():
            result[chosen] = mirrored(tensordict[chosen])
        return result


def _mirror_(part: TensorDictBase) -> None:
    for key in _PICTURES:
        if key in part:
            part[key] = part[key].flip(-1)
    for key in _POINTS:
        if key in part:
            part[key] = part[key] * torch.tensor([-1.0, 1.0])
    if "action_mask" in part:
        part["action_mask"] = mirrored_directions(part["action_mask"])
    if "action" in part:
        action = part["action"]
        part["action"] = action - action % N_DIRECTIONS + MIRRORED_DIRECTION[action % N_DIRECTIONS]


def mirrored_directions(values: Tensor) -> Tensor:
    """Values [..., N * 8] of every object and direction, as the mirrored scene has them."""
    by_direction = values.unflatten(-1, (-1, N_DIRECTIONS))
    return by_direction[..., MIRRORED_DIRECTION].flatten(-2)
