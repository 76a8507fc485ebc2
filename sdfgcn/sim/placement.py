"""Placement of props: collision-free layouts inside the spawn region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shapely import LineString, Polygon
from shapely.affinity import translate

from sdfgcn.task.region import Region

_NEGLIGIBLE = 1e-9  # m2, the overlap that rounding gives shapes that touch


class NoRoom(Exception):  # noqa: N818 - an outcome of sampling, not an error; the caller draws again
    """The props could not be placed within the allowed tries."""


@dataclass(frozen=True)
class Layout:
    """Start and goal positions of an episode, each [n, 2] metres."""

    start: NDArray[np.float64]
    goal: NDArray[np.float64]


@dataclass(frozen=True)
class Spacing:
    """Minimum distances between the objects of a layout.

    Attributes:
        centers: Between two centres, metres (the authors' rule).
        gap: Between two footprints, metres; prevents collisions.
    """

    centers: float
    gap: float


def footprint(vertices: NDArray, quat: NDArray) -> Polygon:
    """The convex hull of an object's projection onto the table, with the object at (0, 0).

    `vertices` [V, 3] are in the object's frame, metres; `quat` is its orientation (w, x, y, z).
    """
    turned = Rotation.from_quat(quat, scalar_first=True).apply(vertices)
    # A line through all points has the same hull and is faster to construct than a MultiPoint.
    return LineString(turned[:, :2]).convex_hull


def is_free(points: NDArray, shapes: Sequence[Polygon], rule: Spacing) -> bool:
    """Whether footprints at the [n, 2] points satisfy the rule."""
    placed = [translate(shape, *point) for shape, point in zip(shapes, points, strict=True)]
    return all(
        np.linalg.norm(points[i] - points[j]) >= rule.centers - 1e-9
        and _apart(placed[i], placed[j], rule.gap - 1e-9)
        for i in range(len(points))
        for j in range(i)
    )


def _apart(one: Polygon, other: Polygon, gap: float) -> bool:
    """Whether two footprints are `gap` metres apart; with a gap of 0, they may touch."""
    if gap > 0.0:
        return one.distance(other) >= gap
    # The distance of shapes that overlap is 0 too.
    return one.intersection(other).area < _NEGLIGIBLE


def sample_positions(
    rng: np.random.Generator,
    shapes: Sequence[Polygon],
    regions: Sequence[Region],
    rule: Spacing,
    max_tries: int,
    middle: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Draw collision-free positions uniformly, one object after another.

    Args:
        rng: Source of randomness.
        shapes: n footprints in their final orientations.
        regions: n rectangles, one for each object's centre.
        rule: Minimum distances.
        max_tries: Draws per object before giving up.
        middle: [2] of a cluster, metres: of the free draws, each object takes the nearest to it;
            None to take the first.

    Returns:
        [n, 2] metres.

    Raises:
        NoRoom: No free position was found for an object.
    """
    points = np.zeros((0, 2))
    placed: list[Polygon] = []
    for shape, region in zip(shapes, regions, strict=True):
        candidates = rng.uniform(region.low, region.high, size=(max_tries, 2))
        if middle is not None:
            away = np.linalg.norm(candidates - middle, axis=1)
            candidates = candidates[np.argsort(away)]
        gaps = np.linalg.norm(candidates[:, None] - points[None, :], axis=-1)
        for candidate in candidates[(gaps >= rule.centers).all(axis=1)]:
            there = translate(shape, *candidate)
            if all(_apart(there, other, rule.gap) for other in placed):
                points = np.vstack([points, candidate])
                placed.append(there)
                break
        else:
            raise NoRoom
    return points
