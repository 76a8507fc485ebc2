"""Weights that a user gives by path: what they must be besides right in names and shapes.

They are read as data: safetensors, or `torch.load` with `weights_only=True`, which runs no code.
"""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor


def not_finite(weights: Mapping[str, Tensor]) -> str | None:
    """The name of the first tensor with a value that is not finite; None if there is none."""
    return next((name for name, value in weights.items() if not value.isfinite().all()), None)
