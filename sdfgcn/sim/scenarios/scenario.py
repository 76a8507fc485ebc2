"""What a scenario is: a rule that draws start and goal layouts."""

from __future__ import annotations

import abc
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import ArenaConfig, ScenarioConfig
from sdfgcn.sim.placement import Layout, Region, sample_positions


@dataclass(frozen=True)
class Situation:
    """What a scenario may know of the objects.

    Attributes:
        radii: [n] bounding circles in their resting pose, metres.
        categories: n category names.
    """

    radii: NDArray[np.float64]
    categories: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of objects."""
        return len(self.radii)


class Scenario(abc.ABC):
    """Draws layouts. Without state: everything random comes from the generator passed in."""

    least_objects = 1
    same_category = False  # whether episodes should hold several objects of one category

    def __init__(self, config: ScenarioConfig, arena: ArenaConfig):
        self.config = config
        self.arena = arena

    @abc.abstractmethod
    def draw(self, rng: np.random.Generator, situation: Situation) -> Layout:
        """Draw a layout.

        Raises:
            NoRoom: It did not fit; the caller draws other objects and tries again.
        """

    def random_start(self, rng: np.random.Generator, situation: Situation) -> NDArray[np.float64]:
        """[n, 2] a uniform start, metres."""
        regions = [Region.spawn(self.arena)] * situation.n
        return sample_positions(
            rng, situation.radii, regions, self.config.spacing, self.config.max_tries
        )
