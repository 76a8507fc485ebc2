"""The names and helpers that every part of the config shares."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from sdfgcn.errors import SdfgcnError

N_DIRECTIONS = 8  # push directions, 45 degrees apart (paper section IV c)
SPLITS = ("train", "test")  # objects seen in training, objects held out

T = TypeVar("T")


def lookup(registry: Mapping[str, T], key: str, name: str) -> T:
    """Return the entry `name` of a registry.

    Args:
        registry: Name -> entry.
        key: The config key that holds `name`, for the message.
        name: The entry asked for.

    Raises:
        SdfgcnError: There is no such entry.
    """
    if name not in registry:
        raise SdfgcnError(f"{key} is '{name}', but must be one of {', '.join(sorted(registry))}.")
    return registry[name]
