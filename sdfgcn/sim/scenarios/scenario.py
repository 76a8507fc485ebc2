"""Base class of scenarios, which draw start and goal layouts."""

from __future__ import annotations

import abc
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from shapely import Point, Polygon, hausdorff_distance

from sdfgcn.config import ArenaConfig, ScenarioConfig
from sdfgcn.sim.placement import Layout, Spacing, sample_positions
from sdfgcn.task.region import Region


@dataclass(frozen=True)
class Situation:
    """What a scenario knows about the n objects.

    Attributes:
        start: n footprints in their start orientations.
        goal: n footprints in their goal orientations.
        categories: n category names.
    """

    start: tuple[Polygon, ...]
    goal: tuple[Polygon, ...]
    categories: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of objects."""
        return len(self.categories)

    @property
    def goal_radii(self) -> NDArray[np.float64]:
        """[n] radii of the goal footprints' bounding circles about their origins, metres."""
        return np.array([hausdorff_distance(Point(0, 0), shape) for shape in self.goal])


class Scenario(abc.ABC):
    """Draws layouts; stateless, all randomness comes from the generator passed in."""

    least_objects = 1
    same_category = False  # whether episodes should contain several objects of one category
    same_yaw = False  # whether objects have the same yaw at the start and the goal

    def __init__(self, config: ScenarioConfig, arena: ArenaConfig):
        self.config = config
        self.arena = arena
        self.spacing = Spacing(config.spacing, config.gap)

    @abc.abstractmethod
    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw a layout.

        Raises:
            NoRoom: The objects did not fit; the caller draws other objects and tries again.
        """

    def anywhere(
        self,
        rng: np.random.Generator,
        shapes: Sequence[Polygon],
        middle: NDArray[np.float64] | None = None,
    ) -> NDArray[np.float64]:
        """[n, 2] positions drawn in the spawn region, metres; see `sample_positions`."""
        regions = [Region.spawn(self.arena)] * len(shapes)
        return sample_positions(rng, shapes, regions, self.spacing, self.config.max_tries, middle)
