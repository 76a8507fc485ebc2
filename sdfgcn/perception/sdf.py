"""Signed distance fields of masks by the fast marching method (paper section III B)."""

from __future__ import annotations

import functools

import numpy as np
import skfmm
from numpy.typing import NDArray


def signed_distance(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Signed distance field of one mask.

    Fast marching costs milliseconds, and most objects do not move in most pushes, so results
    are kept per mask.

    Args:
        mask: [H, W].

    Returns:
        [H, W] distance to the mask's contour in pixels, negative inside, positive outside;
        read-only. The contour runs half-way between a pixel inside and one outside. A mask
        without a contour has none: it is the picture's diagonal everywhere, positive for an
        empty mask and negative for a full one.
    """
    mask = np.ascontiguousarray(mask, dtype=bool)
    return _march(np.packbits(mask).tobytes(), mask.shape)


@functools.lru_cache(maxsize=512)
def _march(packed: bytes, shape: tuple[int, int]) -> NDArray[np.float32]:
    count = shape[0] * shape[1]
    mask = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=count).reshape(shape)
    inside = int(mask.sum())
    if inside in (0, count):
        diagonal = np.hypot(*shape)
        field = np.full(shape, -diagonal if inside else diagonal, dtype=np.float32)
    else:
        field = np.asarray(skfmm.distance(0.5 - mask.astype(np.float64)), dtype=np.float32)
    field.flags.writeable = False
    return field


def signed_distances(masks: NDArray[np.bool_]) -> NDArray[np.float32]:
    """[m, H, W] the signed distance field of each of the [m, H, W] masks, pixels."""
    if len(masks) == 0:
        return np.zeros(masks.shape, dtype=np.float32)
    return np.stack([signed_distance(mask) for mask in masks])
