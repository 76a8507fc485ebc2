"""`circle`: the goal is a ring."""

from __future__ import annotations

import numpy as np

from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import Layout, NoRoom, is_free
from sdfgcn.sim.scenarios.scenario import Scenario, Situation
from sdfgcn.task.region import Region


@SCENARIOS.register("circle")
class Circle(Scenario):
    """The goal spaces the objects evenly, in random order, on the smallest possible circle."""

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw a uniform start and a goal circle with random position and phase."""
        start = self.anywhere(rng, situation.start)
        n = situation.n
        order = rng.permutation(n)
        radius = 0.0
        if n > 1:
            radii = situation.goal_radii[order]
            neighbours = (radii + np.roll(radii, 1)).max() + self.spacing.gap
            radius = max(self.spacing.centers, neighbours) / (2.0 * np.sin(np.pi / n))
        angles = rng.uniform(0.0, 2.0 * np.pi) + 2.0 * np.pi * np.arange(n) / n
        ring = radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        spawn = Region.spawn(self.arena)
        low, high = spawn.low - ring.min(axis=0), spawn.high - ring.max(axis=0)
        if (low > high).any():
            raise NoRoom
        goal = np.empty_like(start)
        goal[order] = ring + rng.uniform(low, high)
        # Neighbours fit by construction; opposite objects may still be too close.
        if not is_free(goal, situation.goal, self.spacing):
            raise NoRoom
        return Layout(start, goal)
