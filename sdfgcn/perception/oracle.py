"""True masks, matched by identity: for fast training and as an upper bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdfgcn.perception.base import Perception
from sdfgcn.registry import PERCEPTIONS
from sdfgcn.task.world import View


@PERCEPTIONS.register("oracle")
class OraclePerception(Perception):
    """Row i is the episode's object i, in the scene and in the goal."""

    rows_are_slots = True

    def see_goal(self, view: View) -> NDArray[np.bool_]:
        """[n, H, W] the goal's true masks."""
        return view.true_masks()

    def see(self, view: View) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """The true masks [n, H, W], all matched."""
        masks = view.true_masks()
        return masks, np.ones(len(masks), dtype=bool)
