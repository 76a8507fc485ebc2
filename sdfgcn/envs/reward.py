"""The reward of one push (paper section IV d); `conf/reward/` holds its terms."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import RewardConfig


def reward_terms(
    config: RewardConfig,
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    *,
    success: bool,
    out_of_range: bool,
    vanished: int = 0,
    none_left: bool = False,
) -> dict[str, float]:
    """The terms of the reward by name; their sum is the reward.

    Args:
        config: Weights.
        before: [k] distances to the goal before the push, metres; NaN where unknown.
        after: [k] distances after the push, of the same objects or rows.
        success: Every object lies at its goal.
        out_of_range: An object left the allowed region.
        vanished: How many objects disappeared from the detections with this push.
        none_left: No object is detected.

    Returns:
        `progress`: weight * sum of (before - after), where both are known. `step`: cost of a push.
        `floor`: the amount that raises progress and step to their lower bound, if there is one.
        `success`, `out_of_range`, `vanished`, `none_left`: given when the event happens.
    """
    progress = config.progress * float(np.nansum(before - after))
    bounded = progress + config.step
    return {
        "progress": progress,
        "step": config.step,
        "floor": 0.0 if config.floor is None else max(0.0, config.floor - bounded),
        "success": config.success if success else 0.0,
        "out_of_range": config.out_of_range if out_of_range else 0.0,
        "vanished": config.vanished * vanished,
        "none_left": config.none_left if none_left else 0.0,
    }
