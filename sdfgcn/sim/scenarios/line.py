"""`line`: the goal is a straight row."""

from __future__ import annotations

import numpy as np

from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import Layout, NoRoom
from sdfgcn.sim.scenarios.scenario import Scenario, Situation
from sdfgcn.task.region import Region


@SCENARIOS.register("line")
class Line(Scenario):
    """The goal puts the objects in random order on a line with random slope and position."""

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw a uniform start and a goal line as tightly spaced as the rules allow."""
        start = self.anywhere(rng, situation.start)
        order = rng.permutation(situation.n)
        radii = situation.goal_radii[order]
        gaps = np.maximum(self.spacing.centers, radii[:-1] + radii[1:] + self.spacing.gap)
        along = np.concatenate([[0.0], np.cumsum(gaps)])
        spawn = Region.spawn(self.arena)
        for _ in range(self.config.max_tries):
            angle = rng.uniform(0.0, np.pi)
            row = along[:, None] * np.array([np.cos(angle), np.sin(angle)])
            room = (spawn.high - spawn.low) - np.ptp(row, axis=0)
            if (room >= 0.0).all():
                goal = np.empty_like(start)
                goal[order] = row - row.min(axis=0) + spawn.low + rng.uniform(0.0, 1.0, 2) * room
                return Layout(start, goal)
        raise NoRoom
