"""Pictures of objects as the input of convolutions."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor


def scaled_sdf(sdf: Tensor, unit: float) -> Tensor:
    """Signed distances in units of so many pixels; in place."""
    return sdf.mul_(1.0 / unit)


def object_mask(sdf: Tensor, unit: float) -> Tensor:
    """1 inside the object, 0 outside; in place."""
    return sdf.lt_(0.0)


# Named functions: actors in other processes get a network by pickling it.
PICTURES: dict[str, Callable[[Tensor, float], Tensor]] = {
    "sdf": scaled_sdf,
    "mask": object_mask,
}
