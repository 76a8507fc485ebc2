"""`packed`: start and goal are clusters of objects that nearly touch.

What is pushed first, and from which side, matters: there is hardly room to come down between two
objects, and a push of one moves its neighbours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from shapely import Polygon

from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import Layout
from sdfgcn.sim.scenarios.scenario import Scenario, Situation
from sdfgcn.task.region import Region


@SCENARIOS.register("packed")
class Packed(Scenario):
    """Two clusters, each somewhere in the spawn region."""

    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw the two clusters independently."""
        return Layout(self._cluster(rng, situation.start), self._cluster(rng, situation.goal))

    def _cluster(self, rng: np.random.Generator, shapes: Sequence[Polygon]) -> NDArray[np.float64]:
        """[n, 2] positions, each as near as possible to a random middle, metres."""
        region = Region.spawn(self.arena)
        middle = rng.uniform(region.low, region.high)
        return self.anywhere(rng, shapes, middle)
