"""What the configs of several Q-networks check in the same way."""

from __future__ import annotations

from collections.abc import Sequence

from sdfgcn.errors import SdfgcnError


def check_widths(
    key: str, values: Sequence[Sequence[int]], blocks: Sequence[Sequence[object]]
) -> None:
    """Check for whole numbers of at least 1, one for every entry of every block.

    Args:
        key: Where `values` stand in the config.
        values: Block by block.
        blocks: Their lengths are what those of `values` must be.

    Raises:
        SdfgcnError: A number is missing, or below 1.
    """
    lengths = [len(block) for block in blocks]
    if not values or [len(block) for block in values] != lengths or min(lengths) < 1:
        raise SdfgcnError(
            f"{key} is {values}, but must have an entry for every block and layer of channels, "
            f"whose lengths are {lengths}."
        )
    if min(min(block) for block in values) < 1:
        raise SdfgcnError(f"{key} is {values}, but every number must be at least 1.")


def check_above_zero(key: str, value: float) -> None:
    """Check a number.

    Raises:
        SdfgcnError: It is not above zero.
    """
    if value <= 0:
        raise SdfgcnError(f"{key} is {value}, but must be above 0.")
