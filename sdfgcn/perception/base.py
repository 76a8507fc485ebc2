"""Base class of perceptions, which turn pictures into rows of masks matched with goal rows."""

from __future__ import annotations

import abc

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import PerceptionConfig
from sdfgcn.task.world import View


class Perception(abc.ABC):
    """Sees the goal once per episode, then the current scene at each step.

    Each detected object has a row, which it keeps from picture to picture as far as it can be
    recognised. Matched rows i of the scene and the goal show the same object. The mask of a row
    without a detected object is all false.
    """

    rows_are_slots = False  # whether row i is always the episode's object i

    def __init__(self, config: PerceptionConfig, max_objects: int):
        """Set up; `max_objects` is the maximum number of rows."""
        self.config = config
        self.max_objects = max_objects

    @abc.abstractmethod
    def see_goal(self, view: View) -> NDArray[np.bool_]:
        """Begin an episode; return the goal's masks [n, H, W]."""

    @abc.abstractmethod
    def see(self, view: View) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Detect the objects and match them with the goal's.

        Returns:
            [k, H, W] masks, and [k] whether each row is matched with its goal row.
        """


def detected(masks: NDArray[np.bool_], min_pixels: int) -> NDArray[np.bool_]:
    """[m] whether each of the [m, H, W] masks is large enough to count as a detection."""
    return masks.sum(axis=(1, 2)) >= min_pixels
