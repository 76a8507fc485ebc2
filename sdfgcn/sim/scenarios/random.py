"""`random`: start and goal drawn uniformly (the authors' training and evaluation)."""

from __future__ import annotations

import numpy as np

from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import Layout
from sdfgcn.sim.scenarios.scenario import Scenario, Situation


@SCENARIOS.register("random")
class Random(Scenario):
    """Start and goal are unrelated."""

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw start and goal independently."""
        return Layout(self.anywhere(rng, situation.start), self.anywhere(rng, situation.goal))
