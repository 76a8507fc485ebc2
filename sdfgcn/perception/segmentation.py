"""From a picture to object masks."""

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
