"""True masks, matched by identity: for fast training, and as an upper bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdfgcn.perception.perception import Perception, View
from sdfgcn.registry import PERCEPTIONS


def oracle_masks(geom_ids: NDArray[np.int64], slot_of_geom: NDArray, n: int) -> NDArray[np.bool_]:
    """True masks, from the renderer's segmentation.

    Args:
        geom_ids: [H, W] the geom that each pixel shows, -1 for none.
        slot_of_geom: [ngeom + 1] the slot of the object that a geom belongs to, else -1; the
            last entry is for "none".
        n: Number of objects.

    Returns:
        [n, H, W] one mask per slot; all false where an object is hidden.
    """
    return slot_of_geom[geom_ids] == np.arange(n)[:, None, None]


@PERCEPTIONS.register("oracle")
class OraclePerception(Perception):
    """Row i is the episode's object i, in both pictures."""

    rows_are_slots = True

    def see_goal(self, view: View) -> NDArray[np.bool_]:
        """[n, H, W] the goal's true masks."""
        return view.true_masks()

    def see(self, view: View) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """[n, H, W] the true masks, each matched with the same row of the goal."""
        masks = view.true_masks()
        return masks, np.arange(len(masks))
