"""Building blocks of all config dataclasses: base class, ranges of fields and their checks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from omegaconf import MISSING

from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config

SPLITS = ("train", "test")  # objects seen in training, held-out objects

T = TypeVar("T")


@dataclass
class ComponentConfig:
    """The config of a component picked by name; each component extends it.

    Attributes:
        name: The option of its config group, as in `conf/<group>/<name>.yaml`.
    """

    name: str = MISSING

    def check(self, config: Config) -> None:
        """Check what the types cannot, given the whole config.

        Raises:
            SdfgcnError: One sentence that names the key, its value and what would work.
        """


@dataclass(frozen=True)
class Range:
    """The values that a config field may have, besides its type.

    Attributes:
        holds: Whether a value is allowed; for a list, called with each entry.
        words: The range in words, such as "must be above 0".
        whole: Whether `holds` is called with a list as a whole.
    """

    holds: Callable[[Any], bool]
    words: str
    whole: bool = False


def ranged(
    holds: Callable[[Any], bool], words: str, default: Any = MISSING, whole: bool = False
) -> Any:
    """A field of a config dataclass with a `Range`; None is not checked against it."""
    return field(default=default, metadata={"range": Range(holds, words, whole)})


def positive(default: Any = MISSING) -> Any:
    """A field for numbers above 0."""
    return ranged(lambda value: value > 0, "must be above 0", default)


def at_least(least: float, default: Any = MISSING) -> Any:
    """A field for numbers of at least `least`."""
    return ranged(lambda value: value >= least, f"must be at least {least}", default)


def fraction(default: Any = MISSING) -> Any:
    """A field for numbers from 0 to 1."""
    return ranged(lambda value: 0 <= value <= 1, "must lie between 0 and 1", default)


def below_one(default: Any = MISSING) -> Any:
    """A field for numbers of at least 0 and below 1."""
    return ranged(lambda value: 0 <= value < 1, "must be at least 0 and below 1", default)


def one_of(*names: str | int) -> Any:
    """A field for one of the given values."""
    return ranged(lambda value: value in names, f"must be one of {', '.join(map(str, names))}")


def interval(least: float = -math.inf) -> Any:
    """A field for a list of two numbers of at least `least`, the smaller first."""
    limit = "" if least == -math.inf else f" from {least} on"
    return ranged(
        lambda value: len(value) == 2 and least <= value[0] <= value[1],
        f"must be two numbers{limit}, the smaller first",
        whole=True,
    )


def vector(length: int) -> Any:
    """A field for a list of `length` numbers."""
    return ranged(lambda value: len(value) == length, f"must be {length} numbers", whole=True)


def check_ranges(value: Any, key: str = "", allowed: Range | None = None) -> None:
    """Check recursively that every number of a config is finite and in the range of its field.

    Args:
        value: A config dataclass, or the value of one of its fields.
        key: Its dotted path in the config; empty for the root.
        allowed: The range of its field.

    Raises:
        SdfgcnError: One sentence that names the key, its value and what would work.
    """
    if is_dataclass(value):
        for each in fields(value):
            inner = f"{key}.{each.name}".removeprefix(".")
            check_ranges(getattr(value, each.name), inner, each.metadata.get("range"))
    elif isinstance(value, dict):
        for name, item in value.items():
            check_ranges(item, f"{key}.{name}")
    elif value is not None:
        _check_range(value, key, allowed)


def _check_range(value: Any, key: str, allowed: Range | None) -> None:
    entries = list(_entries(value))
    seen, subject = (f"'{value}'" if isinstance(value, str) else value), "but"
    if isinstance(value, list) and not (allowed and allowed.whole):
        subject = "but every number"
    asked = [value] if allowed and allowed.whole else entries
    if allowed and not all(allowed.holds(entry) for entry in asked):
        raise SdfgcnError(f"{key} is {seen}, {subject} {allowed.words}.")
    if any(isinstance(entry, float) and not math.isfinite(entry) for entry in entries):
        raise SdfgcnError(f"{key} is {seen}, {subject} must be finite.")


def _entries(value: Any) -> Iterator[Any]:
    """The entries of a list, also a nested one; any other value itself."""
    if isinstance(value, list):
        for item in value:
            yield from _entries(item)
    else:
        yield value


def lookup(registry: Mapping[str, T], key: str, name: str) -> T:
    """Return the entry `name` of a registry; `key` is the config key that holds the name.

    Raises:
        SdfgcnError: There is no such entry.
    """
    if name not in registry:
        raise SdfgcnError(f"{key} is '{name}', but must be one of {', '.join(sorted(registry))}.")
    return registry[name]
