"""What a scenario is: a rule that draws start and goal layouts."""

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
    """What a scenario may know of the n objects.

    Attributes:
        start: n footprints, turned as they will lie at the start.
        goal: n footprints, turned as they will lie at the goal.
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
        """[n] bounding circles of the goal footprints around their origins, metres."""
        return np.array([hausdorff_distance(Point(0, 0), shape) for shape in self.goal])


class Scenario(abc.ABC):
    """Draws layouts. Without state: everything random comes from the generator passed in."""

    least_objects = 1
    same_category = False  # whether episodes should hold several objects of one category
    same_yaw = False  # whether objects lie at the goal as they lie at the start

    def __init__(self, config: ScenarioConfig, arena: ArenaConfig):
        self.config = config
        self.arena = arena
        self.spacing = Spacing(config.spacing, config.gap)

    @abc.abstractmethod
    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw a layout.

        Raises:
            NoRoom: It did not fit; the caller draws other objects and tries again.
        """

    def anywhere(self, rng: np.random.Generator, shapes: Sequence[Polygon]) -> NDArray[np.float64]:
        """[n, 2] positions drawn uniformly in the spawn region, metres."""
        regions = [Region.spawn(self.arena)] * len(shapes)
        return sample_positions(rng, shapes, regions, self.spacing, self.config.max_tries)
