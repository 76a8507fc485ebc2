"""Where props stand: layouts without collisions inside the spawn region."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import ArenaConfig


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
class Region:
    """An axis-aligned rectangle on the table.

    Attributes:
        low: [2] smallest x and y, metres.
        high: [2] largest x and y, metres.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    @staticmethod
    def spawn(arena: ArenaConfig) -> Region:
        """Where props may be placed."""
        low, high = np.transpose([arena.spawn_x, arena.spawn_y])
        return Region(low, high)

    @staticmethod
    def range(arena: ArenaConfig) -> Region:
        """Where props may be without being out of range."""
        low, high = np.transpose([arena.range_x, arena.range_y])
        return Region(low, high)

    def contains(self, points: NDArray) -> NDArray[np.bool_]:
        """[...] whether each of the [..., 2] points lies inside."""
        return ((points >= self.low) & (points <= self.high)).all(axis=-1)


def clearances(radii: NDArray, spacing: float) -> NDArray[np.float64]:
    """[n, n] smallest distance of each pair of centres, metres.

    At least `spacing` (the authors' rule), and never closer than the props' bounding circles.
    """
    return np.maximum(spacing, radii[:, None] + radii[None, :])


def is_free(points: NDArray, least: NDArray) -> bool:
    """Whether every pair of the [n, 2] points is at least `least` [n, n] metres apart."""
    gaps = np.linalg.norm(points[:, None] - points[None, :], axis=-1)
    np.fill_diagonal(gaps, np.inf)
    return bool((gaps >= least).all())


def sample_positions(
    rng: np.random.Generator,
    radii: NDArray,
    regions: list[Region],
    spacing: float,
    max_tries: int,
    taken: NDArray | None = None,
    taken_radii: NDArray | None = None,
) -> NDArray[np.float64]:
    """Draw positions uniformly, one prop after the other, without collisions.

    Args:
        rng: Source of randomness.
        radii: [n] bounding circles, metres.
        regions: n rectangles, where each prop may stand.
        spacing: Smallest distance between two centres, metres.
        max_tries: Draws per prop before the layout is given up.
        taken: [k, 2] centres that are occupied already.
        taken_radii: [k] their bounding circles.

    Returns:
        [n, 2] metres.

    Raises:
        NoRoom: A prop found no free place.
    """
    points = np.zeros((0, 2)) if taken is None else np.asarray(taken)
    circles = np.zeros(0) if taken_radii is None else np.asarray(taken_radii)
    first = len(points)
    for radius, region in zip(radii, regions, strict=True):
        candidates = rng.uniform(region.low, region.high, size=(max_tries, 2))
        gaps = np.linalg.norm(candidates[:, None] - points[None, :], axis=-1)
        free = (gaps >= np.maximum(spacing, circles + radius)).all(axis=1)
        if not free.any():
            raise NoRoom
        points = np.vstack([points, candidates[np.argmax(free)]])
        circles = np.append(circles, radius)
    return points[first:]
