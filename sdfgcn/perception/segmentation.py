"""From a picture to object masks, and which of two pictures' masks belong together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


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


def detected(masks: NDArray[np.bool_], min_pixels: int) -> NDArray[np.bool_]:
    """[n] whether each of the [n, H, W] masks is large enough to count as a detection."""
    return masks.sum(axis=(1, 2)) >= min_pixels


def oracle_correspondence(
    found: NDArray[np.bool_], goal_found: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Match by identity: a slot is the same object in both pictures.

    Args:
        found: [n] which slots are detected in the current picture.
        goal_found: [n] which slots are detected in the goal picture.

    Returns:
        [n] for each current node the goal node it is matched with, -1 where either is missing.
    """
    return np.where(found & goal_found, np.arange(len(found)), -1)
