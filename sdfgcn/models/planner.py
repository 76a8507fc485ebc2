"""How the planner of the push model scores predicted positions."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from sdfgcn.config import number, one_of


@dataclass
class PlannerConfig:
    """The terms of the score (`planner` in `conf/model/push_model.yaml`).

    Attributes:
        push: Distance by which a push brings an object nearer, metres.
        aim: Distance from the goal at which an object needs no more pushes, metres.
        away: Pushes that an object costs for not being at its goal, besides those for its distance.
        noise: Standard deviation of the distance between two masks' centres from that between the
            objects, metres: an object may not be at its goal though it seems so.
        risk: Pushes that an object out of range costs.
        depth: Pushes that it looks ahead, 1 or 2.
        width: Pushes after which it looks for a second one: the most valuable.
    """

    push: float = number(0.0001, 10)
    aim: float = number(0, 10)
    away: float = number(0, 1_000_000)
    noise: float = number(0, 10)
    risk: float = number(0, 1_000_000)
    depth: int = one_of(1, 2)
    width: int = number(1, 10_000)


def pushes_needed(
    config: PlannerConfig, threshold: float, distance: Tensor, deviation: Tensor
) -> Tensor:
    """Expected pushes until an object is at its goal.

    Args:
        config: The terms.
        threshold: Distance within which it is at its goal, metres.
        distance: [...] predicted distance to its goal, metres.
        deviation: [...] standard deviation of the prediction, metres; 0 where it is seen.
    """
    way = (distance - config.aim).clamp_min(0.0) / config.push
    unsure = (deviation.square() + config.noise**2).sqrt()
    return way + config.away * _above(distance - threshold, unsure)


def risk_of_leaving(inside_by: Tensor, deviation: Tensor) -> Tensor:
    """Probability that an object is out of range.

    Args:
        inside_by: [...] predicted distance to the border, metres, positive inside.
        deviation: [...] standard deviation of the prediction, metres.
    """
    return _above(-inside_by, deviation)


def _above(value: Tensor, deviation: Tensor) -> Tensor:
    """Probability that a normal variable is above 0; a step if it has no deviation."""
    spread = torch.special.ndtr(value / deviation.clamp_min(1e-6))
    return torch.where(deviation > 0.0, spread, (value > 0.0).to(value.dtype))
