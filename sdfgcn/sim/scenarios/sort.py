"""`sort`: the goal groups the objects by category."""

from __future__ import annotations

import numpy as np

from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import Layout, sample_positions
from sdfgcn.sim.scenarios.scenario import Scenario, Situation
from sdfgcn.task.region import Region


@SCENARIOS.register("sort")
class Sort(Scenario):
    """Each category gets its own strip of the table; the strips are in random order."""

    same_category = True

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw a uniform start and a goal that is uniform within each category's strip."""
        start = self.anywhere(rng, situation.start)
        names = sorted(set(situation.categories))
        order = rng.permutation(len(names))
        # A strip's width is proportional to its number of objects.
        counts = np.array([situation.categories.count(names[i]) for i in order])
        spawn = Region.spawn(self.arena)
        edges = spawn.low[0] + np.concatenate([[0.0], np.cumsum(counts) / situation.n]) * (
            spawn.high[0] - spawn.low[0]
        )
        strips = {
            names[i]: Region(
                np.array([edges[k], spawn.low[1]]), np.array([edges[k + 1], spawn.high[1]])
            )
            for k, i in enumerate(order)
        }
        goal = sample_positions(
            rng,
            situation.goal,
            [strips[category] for category in situation.categories],
            self.spacing,
            self.config.max_tries,
        )
        return Layout(start, goal)
