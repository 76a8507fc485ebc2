"""Where props stand: layouts without collisions inside the spawn region."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shapely import LineString, Polygon
from shapely.affinity import translate

from sdfgcn.task.region import Region


class NoRoom(Exception):  # noqa: N818 - an outcome of sampling; the caller draws again
    """The props could not be placed in the tries given."""


@dataclass(frozen=True)
class Layout:
    """Start and goal of an episode.

    Attributes:
        start: [n, 2] metres.
        goal: [n, 2] metres.
    """

    start: NDArray[np.float64]
    goal: NDArray[np.float64]


@dataclass(frozen=True)
class Spacing:
    """How far apart objects of one layout are.

    Attributes:
        centers: Least distance of two centres, metres (the authors' rule).
        gap: Least distance of two footprints, metres: no collision.
    """

    centers: float
    gap: float


def footprint(vertices: NDArray, quat: NDArray) -> Polygon:
    """The convex hull of what an object covers of the table, its origin at (0, 0).

    Its `vertices` [V, 3] are in its own frame, metres; `quat` is its orientation (w, x, y, z).
    """
    turned = Rotation.from_quat(quat, scalar_first=True).apply(vertices)
    # One line through all the points: quicker to make than the points, and its hull is theirs.
    return LineString(turned[:, :2]).convex_hull


def is_free(points: NDArray, shapes: Sequence[Polygon], rule: Spacing) -> bool:
    """Whether footprints at the [n, 2] points keep the rule with each other."""
    placed = [translate(shape, *point) for shape, point in zip(shapes, points, strict=True)]
    return all(
        np.linalg.norm(points[i] - points[j]) >= rule.centers - 1e-9
        and placed[i].distance(placed[j]) >= rule.gap - 1e-9
        for i in range(len(points))
        for j in range(i)
    )


def sample_positions(
    rng: np.random.Generator,
    shapes: Sequence[Polygon],
    regions: Sequence[Region],
    rule: Spacing,
    max_tries: int,
) -> NDArray[np.float64]:
    """Draw positions uniformly, one object after the other, without collisions.

    Args:
        rng: Source of randomness.
        shapes: n footprints, turned as they will lie.
        regions: n rectangles, where each object's centre may be.
        rule: The distances to keep.
        max_tries: Draws per object before the layout is given up.

    Returns:
        [n, 2] metres.

    Raises:
        NoRoom: An object found no free place.
    """
    points = np.zeros((0, 2))
    placed: list[Polygon] = []
    for shape, region in zip(shapes, regions, strict=True):
        candidates = rng.uniform(region.low, region.high, size=(max_tries, 2))
        gaps = np.linalg.norm(candidates[:, None] - points[None, :], axis=-1)
        for candidate in candidates[(gaps >= rule.centers).all(axis=1)]:
            there = translate(shape, *candidate)
            if all(there.distance(other) >= rule.gap for other in placed):
                points = np.vstack([points, candidate])
                placed.append(there)
                break
        else:
            raise NoRoom
    return points
