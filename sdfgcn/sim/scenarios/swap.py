"""`swap`: two objects exchange places (paper Fig. 5)."""

from __future__ import annotations

import numpy as np

from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import Layout, NoRoom, is_free
from sdfgcn.sim.scenarios.scenario import Scenario, Situation


@SCENARIOS.register("swap")
class Swap(Scenario):
    """Two objects exchange places; the others are obstacles and stay where they are."""

    least_objects = 2
    same_yaw = True

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw a uniform start; the goal exchanges two random objects."""
        start = self.anywhere(rng, situation.start)
        first, second = rng.choice(situation.n, size=2, replace=False)
        goal = start.copy()
        goal[[first, second]] = start[[second, first]]
        # A larger object may not fit where a smaller one stood.
        if not is_free(goal, situation.goal, self.spacing):
            raise NoRoom
        return Layout(start, goal)
