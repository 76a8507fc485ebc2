"""`random`: start and goal drawn uniformly (the authors' training and evaluation)."""

from __future__ import annotations

import numpy as np

from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import Layout
from sdfgcn.sim.scenarios.scenario import Scenario, Situation


@SCENARIOS.register("random")
class Random(Scenario):
    """Every object somewhere, to be brought somewhere else."""

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Start and goal, independent of each other."""
        return Layout(self.anywhere(rng, situation.start), self.anywhere(rng, situation.goal))
