"""Reward terms with sums done by hand."""

import numpy as np
import pytest
from configs import real_config

from sdfgcn.envs.reward import reward_terms

ZERO = {
    "progress": 0.0,
    "step": -0.02,
    "floor": 0.0,
    "success": 0.0,
    "out_of_range": 0.0,
    "vanished": 0.0,
    "none_left": 0.0,
}


def terms(before: list[float], after: list[float], **events) -> dict[str, float]:
    events = {"success": False, "out_of_range": False} | events
    config = real_config("objects=household").env.reward
    return reward_terms(config, np.array(before), np.array(after), **events)


@pytest.mark.parametrize(
    ("before", "after", "events", "changed", "reward"),
    [
        # 6 cm nearer: 30 * 0.06 - 0.02.
        ([0.10], [0.04], {}, {"progress": 1.8}, 1.78),
        # One 6 cm nearer, another 2 cm further away.
        ([0.10, 0.05], [0.04, 0.07], {}, {"progress": 1.2}, 1.18),
        # Nothing moved.
        ([0.10, 0.05], [0.10, 0.05], {}, {}, -0.02),
        # 3 cm away: -0.9 - 0.02 is above the floor; 4 cm: -1.2 - 0.02 is lifted by 0.22.
        ([0.10], [0.13], {}, {"progress": -0.9}, -0.92),
        ([0.10], [0.14], {}, {"progress": -1.2, "floor": 0.22}, -1.0),
        # Events come on top.
        ([0.08], [0.04], {"success": True}, {"progress": 1.2, "success": 10.0}, 11.18),
        ([0.0], [0.0], {"out_of_range": True}, {"out_of_range": -2.0}, -2.02),
        (
            [0.10],
            [0.20],
            {"out_of_range": True},
            {"progress": -3.0, "floor": 2.02, "out_of_range": -2.0},
            -3.0,
        ),
        ([0.1, 0.1], [0.1, 0.1], {"vanished": 2}, {"vanished": -1.0}, -1.02),
        (
            [0.1],
            [0.1],
            {"vanished": 1, "none_left": True},
            {"vanished": -0.5, "none_left": -1.0},
            -1.52,
        ),
    ],
)
def test_terms(before, after, events, changed, reward):
    found = terms(before, after, **events)
    assert found == pytest.approx(ZERO | changed)
    assert sum(found.values()) == pytest.approx(reward)
