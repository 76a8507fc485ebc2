"""What a perception is: from a picture to rows of masks, each matched with the goal's row."""

from __future__ import annotations

import abc

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import PerceptionConfig
from sdfgcn.task.world import View


class Perception(abc.ABC):
    """Sees the goal once an episode, then one picture after the other.

    Each detected object has a row, and keeps it from picture to picture as far as that can be
    seen. Row i of a picture and row i of the goal show the same object where they are matched. The
    mask of a row without a detected object is all false.
    """

    rows_are_slots = False  # whether row i is by construction the episode's object i

    def __init__(self, config: PerceptionConfig, max_objects: int):
        """Load what it takes; `max_objects` is the most rows it may return."""
        self.config = config
        self.max_objects = max_objects

    @abc.abstractmethod
    def see_goal(self, view: View) -> NDArray[np.bool_]:
        """[n, H, W] the goal's masks; begins an episode."""

    @abc.abstractmethod
    def see(self, view: View) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Find the objects and match them with the goal's.

        Returns:
            [k, H, W] masks, and [k] for each row whether it is matched with the goal's row.
        """


def detected(masks: NDArray[np.bool_], min_pixels: int) -> NDArray[np.bool_]:
    """[m] whether each of the [m, H, W] masks is large enough to count as a detection."""
    return masks.sum(axis=(1, 2)) >= min_pixels
