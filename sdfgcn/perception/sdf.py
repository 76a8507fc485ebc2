"""Signed distance fields of masks (paper section III B).

The paper solves the Eikonal equation with the fast marching method; the exact Euclidean distance
transform takes a third of the time. `SDF_METHODS` maps the values of `env.perception.sdf` to them.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

import numpy as np
import skfmm
import torch
from numpy.typing import DTypeLike, NDArray
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from sdfgcn.config import lookup


def fast_marching(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Distance to the contour of an [H, W] mask by scikit-fmm, pixels, negative inside.

    The contour joins the midpoints between inside and outside pixels, so it cuts corners. The
    distance is propagated over the pixel grid and so only approximate.
    """
    return np.asarray(skfmm.distance(0.5 - mask.astype(np.float64)))


def euclidean(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Distance to the contour of an [H, W] mask by scipy, pixels, negative inside.

    The exact distance to the centre of the nearest pixel on the other side, less the half pixel
    between that centre and the contour.
    """
    inside, outside = distance_transform_edt(mask), distance_transform_edt(~mask)
    return np.where(mask, 0.5 - inside, outside - 0.5)


SDF_METHODS: dict[str, Callable[[NDArray[np.bool_]], NDArray[np.float64]]] = {
    "fmm": fast_marching,
    "edt": euclidean,
}


class SdfTransform:
    """Converts between masks and signed distance fields, with an LRU cache of fields.

    A field takes milliseconds to compute, and most pushes leave most objects in place. The env
    turns masks into fields; the replay buffer stores packed masks and restores the fields when
    sampling.
    """

    def __init__(
        self, method: str, size: int, kept: int = 512, precision: DTypeLike = np.float32
    ) -> None:
        """Create a transform with an empty cache.

        Args:
            method: A key of `SDF_METHODS`.
            size: Height and width of the pictures, pixels.
            kept: Capacity of the cache, in fields.
            precision: Data type of cached fields. Half precision errs by less than 0.13 pixels in
                a 96-pixel picture, and by less than 0.001 near the contour.

        Raises:
            SdfgcnError: There is no such method.
        """
        self._distance = lookup(SDF_METHODS, "env.perception.sdf", method)
        self._shape = (size, size)
        self._kept = kept
        self._precision = precision
        self._fields: OrderedDict[bytes, NDArray] = OrderedDict()

    def __len__(self) -> int:
        """Number of cached fields."""
        return len(self._fields)

    def fields(self, masks: NDArray[np.bool_]) -> NDArray[np.float32]:
        """[m, H, W] signed distance fields of masks [m, H, W], pixels, negative inside.

        The contour runs midway between inside and outside pixels. Without a contour, the field is
        the picture diagonal everywhere: positive for an empty mask, negative for a full one.
        """
        fields = np.empty(masks.shape, dtype=np.float32)
        for i, mask in enumerate(masks):
            fields[i] = self._field(np.packbits(mask).tobytes())
        return fields

    def pack(self, sdf: Tensor, node_mask: Tensor) -> Tensor:
        """Pack fields [*B, N, H, W] into mask bits, uint8 [*B, N, H * W / 8], and cache the fields.

        Args:
            sdf: Pixels, negative inside.
            node_mask: bool [*B, N] which rows hold an object; only their fields are cached.
        """
        fields = sdf.numpy()
        bits = np.packbits((fields < 0.0).reshape(*fields.shape[:-2], -1), axis=-1)
        for row in zip(*np.nonzero(node_mask.numpy()), strict=True):
            self._keep(bits[row].tobytes(), fields[row])
        return torch.from_numpy(bits)

    def unpack(self, bits: Tensor, node_mask: Tensor) -> Tensor:
        """Fields of packed masks, float32 [*B, N, H, W]; zero for rows without an object."""
        packed = bits.numpy()
        fields = np.zeros((*packed.shape[:-1], *self._shape), dtype=np.float32)
        for row in zip(*np.nonzero(node_mask.numpy()), strict=True):
            fields[row] = self._field(packed[row].tobytes())
        return torch.from_numpy(fields)

    def _field(self, packed: bytes) -> NDArray:
        if packed in self._fields:
            self._fields.move_to_end(packed)
        else:
            self._keep(packed, self._compute(packed))
        return self._fields[packed]

    def _keep(self, packed: bytes, field: NDArray) -> None:
        if packed not in self._fields:
            self._fields[packed] = field.astype(self._precision)
            if len(self._fields) > self._kept:
                self._fields.popitem(last=False)
        else:
            self._fields.move_to_end(packed)

    def _compute(self, packed: bytes) -> NDArray:
        count = self._shape[0] * self._shape[1]
        bits = np.unpackbits(np.frombuffer(packed, dtype=np.uint8), count=count)
        mask = bits.reshape(self._shape).astype(bool)
        inside = int(mask.sum())
        if inside in (0, count):
            diagonal = np.hypot(*self._shape)
            return np.full(self._shape, -diagonal if inside else diagonal, dtype=np.float32)
        return self._distance(mask).astype(np.float32)
