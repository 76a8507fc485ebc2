"""Pictures of objects as the input of convolutions."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor


def scaled_sdf(sdf: Tensor, unit: float) -> Tensor:
    """Signed distances in units of so many pixels, about zero; in place.

    Far from every object they are about a unit, and inputs that are all positive learn slowly.
    """
    return sdf.mul_(1.0 / unit).sub_(1.0)


def object_mask(sdf: Tensor, unit: float) -> Tensor:
    """1 inside the object, 0 outside; in place."""
    return sdf.lt_(0.0)


# Named functions: actors in other processes get a network by pickling it.
PICTURES: dict[str, Callable[[Tensor, float], Tensor]] = {
    "sdf": scaled_sdf,
    "mask": object_mask,
}
