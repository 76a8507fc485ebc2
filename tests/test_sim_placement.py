"""Footprints and spacing with shapes whose distances are known."""

import numpy as np
import pytest
from shapely import box
from shapely.affinity import rotate
from toys import box_points

from sdfgcn.sim.placement import NoRoom, Spacing, footprint, is_free, sample_positions
from sdfgcn.task.region import Region

SQUARE = box(-0.02, -0.02, 0.02, 0.02)  # 4 cm, centred
REGION = Region(np.array([-0.1, 0.0]), np.array([0.3, 0.2]))


def quat(axis: str, degrees: float) -> list[float]:
    """w, x, y, z of a turn about one axis."""
    half = np.radians(degrees) / 2
    return [np.cos(half), *(np.sin(half) * (np.array(list("xyz")) == axis))]


def test_footprint_of_a_box_turned_by_45_degrees():
    shape = footprint(box_points(0.08, 0.04, 0.02), quat("z", 45))
    assert shape.area == pytest.approx(0.08 * 0.04)
    half = (0.04 + 0.02) / np.sqrt(2)
    np.testing.assert_allclose(shape.bounds, [-half, -half, half, half])
    # The long side now points along x = y, the short one along x = -y.
    corners = np.array(shape.exterior.coords)
    assert np.ptp(corners @ [1, 1]) / np.sqrt(2) == pytest.approx(0.08)
    assert np.ptp(corners @ [1, -1]) / np.sqrt(2) == pytest.approx(0.04)


def test_footprint_of_a_box_stood_on_its_side():
    shape = footprint(box_points(0.08, 0.04, 0.02), quat("x", 90))
    np.testing.assert_allclose(shape.bounds, [-0.04, -0.01, 0.04, 0.01])


@pytest.mark.parametrize(
    ("distance", "rule", "free"),
    [
        # The centres rule alone: the squares themselves are 4 cm narrower.
        (0.10, Spacing(centers=0.10, gap=0.0), True),
        (0.099, Spacing(centers=0.10, gap=0.0), False),
        # The gap rule alone: at 5 cm the gap is 1 cm.
        (0.05, Spacing(centers=0.0, gap=0.01), True),
        (0.049, Spacing(centers=0.0, gap=0.01), False),
        # Without a gap they may touch, but not overlap.
        (0.04, Spacing(centers=0.0, gap=0.0), True),
        (0.0399, Spacing(centers=0.0, gap=0.0), False),
        (0.0, Spacing(centers=0.0, gap=0.0), False),
        # Touching is not a gap, overlapping even less so.
        (0.04, Spacing(centers=0.0, gap=0.001), False),
        (0.01, Spacing(centers=0.0, gap=0.001), False),
    ],
)
@pytest.mark.parametrize("along", [[1, 0], [0, -1]])
def test_two_squares_side_by_side(distance, rule, free, along):
    points = np.array([[0.05, 0.1], [0.05, 0.1] + distance * np.array(along)])
    assert is_free(points, [SQUARE, SQUARE], rule) is free


def test_gap_follows_the_outline_not_a_bounding_circle():
    # Corner to corner at 7 cm: 7 - 2 * 2.83 = 1.34 cm; side to side it would be 3 cm.
    points, turned = np.array([[0.0, 0.0], [0.07, 0.0]]), rotate(SQUARE, 45)
    assert is_free(points, [turned, turned], Spacing(0.0, 0.0134))
    assert not is_free(points, [turned, turned], Spacing(0.0, 0.0135))
    assert is_free(points, [SQUARE, SQUARE], Spacing(0.0, 0.0299))


def test_every_pair_counts():
    points = np.array([[0.0, 0.0], [0.2, 0.0], [0.05, 0.0], [0.4, 0.0]])
    assert not is_free(points, [SQUARE] * 4, Spacing(0.10, 0.0))
    assert is_free(points[[0, 1, 3]], [SQUARE] * 3, Spacing(0.10, 0.0))


def test_samples_keep_region_and_rule():
    rule, shapes = Spacing(0.06, 0.01), [SQUARE, rotate(SQUARE, 45), SQUARE, SQUARE]
    drawn = []
    for seed in range(40):
        points = sample_positions(np.random.default_rng(seed), shapes, [REGION] * 4, rule, 200)
        assert points.shape == (4, 2)
        assert REGION.contains(points).all()
        assert is_free(points, shapes, rule)
        drawn.append(points)
    low, high = np.min(drawn, axis=(0, 1)), np.max(drawn, axis=(0, 1))
    # 160 points leave no corner of the region out.
    np.testing.assert_allclose([low, high], [REGION.low, REGION.high], atol=0.02)


def test_each_object_has_its_own_region():
    left = Region(np.array([-1.0, 0.0]), np.array([-0.5, 1.0]))
    points = sample_positions(
        np.random.default_rng(0), [SQUARE, SQUARE], [left, REGION], Spacing(0.1, 0.01), 100
    )
    assert left.contains(points[0]) and REGION.contains(points[1])


def test_same_generator_same_places():
    arguments = [SQUARE] * 3, [REGION] * 3, Spacing(0.1, 0.01), 100
    first, again, other = (
        sample_positions(np.random.default_rng(seed), *arguments) for seed in (7, 7, 8)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("rule", [Spacing(0.5, 0.0), Spacing(0.0, 0.45)])
def test_no_room(rule):
    # The region's diagonal is 0.447 m.
    with pytest.raises(NoRoom):
        sample_positions(np.random.default_rng(0), [SQUARE] * 2, [REGION] * 2, rule, 100)


def test_region_holds_its_edges():
    points = np.array([[-0.1, 0.0], [0.3, 0.2], [0.31, 0.1], [0.1, -0.01]])
    assert REGION.contains(points).tolist() == [True, True, False, False]
