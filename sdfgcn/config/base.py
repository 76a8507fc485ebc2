"""What every part of the config shares."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from omegaconf import MISSING

from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config

SPLITS = ("train", "test")  # objects seen in training, objects held out

T = TypeVar("T")


@dataclass
class ComponentConfig:
    """The config of a component that is picked by name; each component extends it.

    Attributes:
        name: The option of its config group, as in `conf/<group>/<name>.yaml`.
    """

    name: str = MISSING

    def check(self, config: Config) -> None:
        """Check what the types cannot, once the whole config is there.

        Raises:
            SdfgcnError: One sentence that names the key, the value seen and what would work.
        """


@dataclass(frozen=True)
class Range:
    """The values that a field of a config may have, besides its type.

    Attributes:
        holds: Whether a value is one of them; of a list, whether each of its entries is.
        words: The same for a sentence, such as "must be above 0".
        whole: Whether `holds` is asked about a list as a whole.
    """

    holds: Callable[[Any], bool]
    words: str
    whole: bool = False


def ranged(
    holds: Callable[[Any], bool], words: str, default: Any = MISSING, whole: bool = False
) -> Any:
    """A field of a config dataclass with a `Range`; None needs no range to be allowed."""
    return field(default=default, metadata={"range": Range(holds, words, whole)})


def positive(default: Any = MISSING) -> Any:
    """A field for numbers above 0."""
    return ranged(lambda value: value > 0, "must be above 0", default)


def at_least(least: float, default: Any = MISSING) -> Any:
    """A field for numbers from `least` on."""
    return ranged(lambda value: value >= least, f"must be at least {least}", default)


def fraction(default: Any = MISSING) -> Any:
    """A field for numbers from 0 to 1."""
    return ranged(lambda value: 0 <= value <= 1, "must lie between 0 and 1", default)


def below_one(default: Any = MISSING) -> Any:
    """A field for numbers from 0 on that stay below 1."""
    return ranged(lambda value: 0 <= value < 1, "must be at least 0 and below 1", default)


def one_of(*names: str | int) -> Any:
    """A field for one of some values."""
    return ranged(lambda value: value in names, f"must be one of {', '.join(map(str, names))}")


def interval(least: float = -math.inf) -> Any:
    """A field for a list of two numbers from `least` on, the smaller first."""
    limit = "" if least == -math.inf else f" from {least} on"
    return ranged(
        lambda value: len(value) == 2 and least <= value[0] <= value[1],
        f"must be two numbers{limit}, the smaller first",
        whole=True,
    )


def vector(length: int) -> Any:
    """A field for a list of so many numbers."""
    return ranged(lambda value: len(value) == length, f"must be {length} numbers", whole=True)


def check_ranges(value: Any, key: str = "", allowed: Range | None = None) -> None:
    """Check a config and all it holds: every number is finite and in the range of its field.

    Args:
        value: A config dataclass, or the value of a field of one.
        key: Where it stands in the config; empty for the whole.
        allowed: The range of its field.

    Raises:
        SdfgcnError: One sentence that names the key, the value seen and what would work.
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
    """The numbers of a list, also of one of lists; of anything else itself."""
    if isinstance(value, list):
        for item in value:
            yield from _entries(item)
    else:
        yield value


def lookup(registry: Mapping[str, T], key: str, name: str) -> T:
    """Return the entry `name` of a registry; `key` is the config key that holds this name.

    Raises:
        SdfgcnError: There is no such entry.
    """
    if name not in registry:
        raise SdfgcnError(f"{key} is '{name}', but must be one of {', '.join(sorted(registry))}.")
    return registry[name]
