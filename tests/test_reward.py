"""Reward terms with sums done by hand, and how far the objects are from their goals."""

import numpy as np
import pytest
from configs import real_config

from sdfgcn.envs.reward import reward_terms
from sdfgcn.envs.standing import nearest_objects, seen_standing, true_standing
from sdfgcn.task.region import Region
from sdfgcn.task.scene import Detections, Scene

NAN = float("nan")

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


@pytest.mark.parametrize(
    ("before", "after", "progress"),
    [
        # What is not known on one of both sides counts for nothing.
        ([0.10, NAN], [0.04, 0.05], 1.8),
        ([0.10, 0.05], [0.04, NAN], 1.8),
        ([NAN, NAN], [0.04, NAN], 0.0),
    ],
)
def test_progress_of_what_is_seen_before_and_after(before, after, progress):
    assert terms(before, after) == pytest.approx(ZERO | {"progress": progress})


@pytest.mark.parametrize(
    ("before", "after", "reward"),
    [([0.10], [0.04], 1.8), ([0.10], [0.30], -6.0), ([0.10, 0.05], [0.10, 0.05], 0.0)],
)
def test_the_papers_reward_is_progress_alone(before, after, reward):
    """Without a cost of a push, a bound or a word about what else happens."""
    config = real_config("objects=household", "reward=paper").env.reward
    found = reward_terms(
        config,
        *(np.array(before), np.array(after)),
        success=True,
        out_of_range=True,
        vanished=2,
        none_left=True,
    )
    assert found == pytest.approx(dict.fromkeys(ZERO, 0.0) | {"progress": reward})


def test_the_bound_can_be_switched_off():
    config = real_config("objects=household", "env.reward.floor=null").env.reward
    before, after = np.array([0.1]), np.array([0.2])
    found = reward_terms(config, before, after, success=False, out_of_range=True)
    wanted = ZERO | {"progress": -3.0, "out_of_range": -2.0}
    assert found == pytest.approx(wanted)


# ------------------------------------------------------------------ how far everything is

ALLOWED = Region(np.array([-0.3, -0.2]), np.array([0.3, 0.4]))


def poses(*points: tuple[float, float]) -> np.ndarray:
    """[n, 7] at different heights, which do not count."""
    rows = [[x, y, 0.02 * i, 1.0, 0.0, 0.0, 0.0] for i, (x, y) in enumerate(points)]
    return np.array(rows)


def scene(*centers: tuple[float, float] | None) -> Scene:
    """A row for each, without an object where None is given."""
    nodes = np.array([center is not None for center in centers])
    points = np.array([center for center in centers if center is not None]).reshape(-1, 2)
    masks = np.ones((len(points), 8, 8), dtype=bool)
    seen = Detections(masks, -masks.astype(np.float32), points, np.full_like(points, 9.0))
    return Scene.of(seen, nodes, len(centers), 8)


def test_true_standing_by_hand():
    goal = poses((0.0, 0.0), (0.1, 0.1))[::-1].copy()
    stands = true_standing(poses((0.1, 0.13), (0.03, 0.04)), goal, 0.05, ALLOWED)
    np.testing.assert_allclose(stands.distances, [0.03, 0.05])
    assert stands.success and not stands.out_of_range
    # One is too far away; within the region, its edge included.
    stands = true_standing(poses((0.1, 0.13), (0.3, 0.4)), goal, 0.05, ALLOWED)
    np.testing.assert_allclose(stands.distances, [0.03, 0.5])
    assert not stands.success and not stands.out_of_range
    stands = true_standing(poses((0.1, 0.13), (0.301, 0.0)), goal, 0.05, ALLOWED)
    assert stands.out_of_range and not stands.success


def test_seen_standing_by_hand():
    current, goal = scene((0.03, 0.04), None, (0.2, 0.2)), scene((0.0, 0.0), None, (0.2, 0.21))
    matched = np.array([True, False, True])
    stands = seen_standing(current, goal, matched, 0.0501, ALLOWED)
    np.testing.assert_allclose(stands.distances, [0.05, NAN, 0.01], atol=1e-7)
    assert stands.success and not stands.out_of_range
    assert not seen_standing(current, goal, matched, 0.0499, ALLOWED).success


def test_an_object_of_the_goal_that_is_not_matched_is_not_there():
    current, goal = scene((0.0, 0.0), (0.1, 0.1)), scene((0.0, 0.0), (0.1, 0.1))
    stands = seen_standing(current, goal, np.array([True, False]), 0.05, ALLOWED)
    np.testing.assert_allclose(stands.distances, [0.0, NAN])
    assert not stands.success
    # An object too many is in nobody's way, unless it leaves the region.
    goal = scene((0.0, 0.0), None)
    stands = seen_standing(current, goal, np.array([True, False]), 0.05, ALLOWED)
    assert stands.success and not stands.out_of_range
    away = scene((0.0, 0.0), (0.1, 0.41))
    assert seen_standing(away, goal, np.array([True, False]), 0.05, ALLOWED).out_of_range


def test_an_empty_goal_is_never_reached():
    empty = scene(None, None)
    stands = seen_standing(empty, empty, np.array([False, False]), 0.05, ALLOWED)
    assert not stands.success and not stands.out_of_range
    assert np.isnan(stands.distances).all()


def test_detections_show_the_nearest_objects():
    true = np.array([[0.11, 0.0], [0.02, 0.0]])
    center = np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.2]])
    # The third is one too many.
    wanted = [[0.02, 0.0], [0.11, 0.0], [0.2, 0.2]]
    np.testing.assert_array_equal(nearest_objects(center, true), wanted)
    np.testing.assert_array_equal(center[0], [0.0, 0.0])
    # Greedily 4 would take 5, leaving 0 for 6: 1 + 6. Together: 4 + 1.
    center, true = np.array([[0.4, 0.0], [0.6, 0.0]]), np.array([[0.5, 0.0], [0.0, 0.0]])
    np.testing.assert_array_equal(nearest_objects(center, true), true[::-1])
    assert nearest_objects(center[:0], true).shape == (0, 2)
