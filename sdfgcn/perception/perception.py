"""What a perception is: from a picture to nodes, each an object's mask, matched with the goal's."""

from __future__ import annotations

import abc
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import PerceptionConfig


class View(Protocol):
    """One moment, as a camera would show it."""

    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] the RGB picture."""

    def true_masks(self) -> NDArray[np.bool_]:
        """[n, H, W] one mask per object; all false where one is hidden."""


class Perception(abc.ABC):
    """Sees the goal once an episode, then one picture after the other.

    Rows are nodes. A row keeps its object from picture to picture, as far as that can be seen;
    its mask is all false while the object is not detected.
    """

    rows_are_slots = False  # whether row i is by construction the episode's object i

    def __init__(self, config: PerceptionConfig, max_objects: int):
        """Load what it takes.

        Args:
            config: Its settings.
            max_objects: The most rows it may return.
        """
        self.config = config
        self.max_objects = max_objects

    @abc.abstractmethod
    def see_goal(self, view: View) -> NDArray[np.bool_]:
        """[n, H, W] the goal's masks; begins an episode."""

    @abc.abstractmethod
    def see(self, view: View) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Find the objects and match them with the goal's.

        Returns:
            [m, H, W] masks, and [m] for each the goal's row that it is matched with, none
            twice; -1 for none.
        """


def detected(masks: NDArray[np.bool_], min_pixels: int) -> NDArray[np.bool_]:
    """[m] whether each of the [m, H, W] masks is large enough to count as a detection."""
    return masks.sum(axis=(1, 2)) >= min_pixels
