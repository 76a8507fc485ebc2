"""Rectangles on the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import ArenaConfig


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
        """Where objects are placed."""
        low, high = np.transpose([arena.spawn_x, arena.spawn_y])
        return Region(low, high)

    @staticmethod
    def range(arena: ArenaConfig) -> Region:
        """Where an object may be; outside it, the object is out of range."""
        low, high = np.transpose([arena.range_x, arena.range_y])
        return Region(low, high)

    @staticmethod
    def reach(arena: ArenaConfig) -> Region:
        """Where the tool may go."""
        low, high = np.transpose([arena.reach_x, arena.reach_y])
        return Region(low, high)

    def contains(self, points: NDArray) -> NDArray[np.bool_]:
        """[...] whether each of the [..., 2] points lies inside."""
        inside = (points >= self.low) & (points <= self.high)
        return inside[..., 0] & inside[..., 1]
