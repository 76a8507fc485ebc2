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
from sdfgcn.sim.placement import Layout, NoRoom, is_free
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
        points = np.zeros((0, 2))
        for i in range(len(shapes)):
            tries = rng.uniform(region.low, region.high, size=(self.config.max_tries, 2))
            nearest = tries[np.argsort(np.linalg.norm(tries - middle, axis=1))]
            for candidate in nearest:
                placed = np.vstack([points, candidate])
                if is_free(placed, shapes[: i + 1], self.spacing):
                    points = placed
                    break
            else:
                raise NoRoom
        return points
