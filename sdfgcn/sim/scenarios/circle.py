"""`circle`: the goal is a ring."""

from __future__ import annotations

import numpy as np

from sdfgcn.sim.placement import Layout, NoRoom, Region, clearances, is_free
from sdfgcn.sim.scenarios.scenario import Scenario, Situation


class Circle(Scenario):
    """Objects end up evenly spread on a circle, the smallest that holds them, in random order."""

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """A uniform start; the goal circle lies at a random place with a random phase."""
        start = self.random_start(rng, situation)
        n = situation.n
        least = clearances(situation.radii, self.config.spacing)
        order = rng.permutation(n)
        radius = 0.0
        if n > 1:
            neighbours = least[order, np.roll(order, 1)].max()
            radius = neighbours / (2.0 * np.sin(np.pi / n))
        angles = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(n) / n
        ring = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        spawn = Region.spawn(self.arena)
        low, high = spawn.low - ring.min(axis=0), spawn.high - ring.max(axis=0)
        if (low > high).any():
            raise NoRoom
        goal = np.empty_like(start)
        goal[order] = ring + rng.uniform(low, high)
        # Neighbours touch by construction up to rounding; others may still be too large.
        if not is_free(goal, least - 1e-9):
            raise NoRoom
        return Layout(start, goal)
