"""Pictures of objects as the input of convolutions."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

# Change signed distances in place; the number is the distance in pixels that becomes 1.
PICTURES: dict[str, Callable[[Tensor, float], Tensor]] = {
    "sdf": lambda sdf, unit: sdf.mul_(1.0 / unit),
    "mask": lambda sdf, unit: sdf.lt_(0.0),
}
