"""Configs as flat dictionaries, and the differences between two of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested dictionaries to one with dotted keys."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        nested = isinstance(value, Mapping)
        found |= flat(value, f"{prefix}{key}.") if nested else {prefix + key: value}
    return found


def differences(before: Mapping[str, Any], now: Mapping[str, Any], shown: int = 3) -> str:
    """Describe how two flat configs differ, for use in a sentence; empty if they are equal.

    A missing key counts as None. Keys beyond the first `shown` are only counted.

    Returns:
        For example "seed (0 there, 1 now), env.split (test there, train now) and 2 more".
    """
    keys = [key for key in sorted({*before, *now}) if before.get(key) != now.get(key)]
    named = ", ".join(
        f"{key} ({before.get(key)} there, {now.get(key)} now)" for key in keys[:shown]
    )
    return named + (f" and {len(keys) - shown} more" if len(keys) > shown else "")
