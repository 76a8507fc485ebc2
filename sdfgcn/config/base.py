"""Building blocks of all config dataclasses: base class, ranges of fields and their checks."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import Field, dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from omegaconf import MISSING

from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config

SPLITS = ("train", "test")  # objects seen in training, held-out objects
MAX_SEED = 2**32 - 1  # of every generator that is seeded

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


# ------------------------------------------------------------------ ranges


@dataclass(frozen=True)
class Range:
    """The values that a config field may have, besides its type; numbers must also be finite.

    Attributes:
        holds: Whether a value is allowed; for a list, called with each entry.
        words: For an error, such as "must be above 0".
        text: For a table, such as "> 0"; for a list without `whole`, of each entry.
        whole: Whether `holds` is called with a list as a whole.
    """

    holds: Callable[[Any], bool]
    words: str
    text: str
    whole: bool = False


def ranged(
    holds: Callable[[Any], bool],
    words: str,
    default: Any = MISSING,
    whole: bool = False,
    text: str = "",
) -> Any:
    """A field of a config dataclass with a `Range`; None is not checked against it."""
    text = text or words.removeprefix("must be ").removeprefix("must ")
    kept = {"range": Range(holds, words, text, whole)}
    if isinstance(default, list):
        return field(default_factory=default.copy, metadata=kept)
    return field(default=default, metadata=kept)


def number(
    low: float = -math.inf,
    high: float = math.inf,
    *,
    above: float = -math.inf,
    below: float = math.inf,
    default: Any = MISSING,
) -> Any:
    """A field for numbers from `low` to `high`, and greater than `above` and less than `below`."""
    limits = _Limits(low, high, above, below)
    return ranged(limits.hold, f"must {limits.words}", default, text=limits.text)


def positive(most: float = math.inf, default: Any = MISSING) -> Any:
    """A field for numbers above 0, and of at most `most`."""
    return number(above=0, high=most, default=default)


def at_least(least: float, most: float = math.inf, default: Any = MISSING) -> Any:
    """A field for numbers of at least `least`, and at most `most`."""
    return number(least, most, default=default)


def fraction(default: Any = MISSING) -> Any:
    """A field for numbers from 0 to 1."""
    return number(0, 1, default=default)


def below_one(default: Any = MISSING) -> Any:
    """A field for numbers of at least 0 and below 1."""
    return number(0, below=1, default=default)


def one_of(*names: str | int, default: Any = MISSING) -> Any:
    """A field for one of the given values."""
    listed = ", ".join(map(str, names))
    return ranged(lambda value: value in names, f"must be one of {listed}", default)


def matching(pattern: str, words: str) -> Any:
    """A field for text that matches a regular expression as a whole; `words` say which."""
    return ranged(lambda value: re.fullmatch(pattern, value) is not None, f"must be {words}")


def interval(least: float = -math.inf, most: float = math.inf, *, empty: bool = False) -> Any:
    """A field for a list of two numbers, the smaller first; equal ones if it may be `empty`."""
    limits = _Limits(least, most)

    def holds(value: list[float]) -> bool:
        rises = len(value) == 2 and (value[0] <= value[1] if empty else value[0] < value[1])
        return rises and all(map(limits.hold, value))

    sign, order = ("<=", "the smaller first") if empty else ("<", "the first below the second")
    between = f" {limits.phrase}" if limits.phrase else ""
    text = f"[low, high] with low {sign} high" + (f", each {limits.text}" if limits.phrase else "")
    return ranged(holds, f"must be two numbers{between}, {order}", whole=True, text=text)


def vector(length: int, low: float = -math.inf, high: float = math.inf, **limits: float) -> Any:
    """A field for a list of `length` numbers; see `number` for their limits."""
    each = _Limits(low, high, **limits)
    return ranged(
        lambda value: len(value) == length and all(map(each.hold, value)),
        f"must be {length} numbers{f' {each.phrase}' if each.phrase else ''}",
        whole=True,
        text=f"{length} numbers, each {each.text}",
    )


def several(low: float, high: float, default: Any = MISSING) -> Any:
    """A field for a list of one or more numbers, of lists of them, from `low` to `high`."""
    each = _Limits(low, high)
    return ranged(
        lambda value: all(map(each.hold, _entries(value))) and _is_full(value),
        f"must list one or more numbers {each.phrase}",
        default,
        whole=True,
        text=f"one or more, each {each.text}",
    )


def rising(low: float, high: float, default: Any = MISSING) -> Any:
    """A field for a list of numbers from `low` to `high`, each above the one before."""
    each = _Limits(low, high)
    return ranged(
        lambda value: all(map(each.hold, value)) and value == sorted(set(value)),
        f"must list numbers {each.phrase}, each above the one before",
        default,
        whole=True,
        text=f"rising, each {each.text}",
    )


def colour(length: int) -> Any:
    """A field for a colour of 3 (red, green, blue) or 4 numbers (also opacity), each 0 to 1."""
    return vector(length, 0, 1)


def colours() -> Any:
    """A field for a list of one or more colours of red, green and blue."""
    return ranged(
        lambda value: (
            len(value) > 0
            and all(len(each) == 3 and all(0 <= part <= 1 for part in each) for each in value)
        ),
        "must list colours of three numbers between 0 and 1 (red, green, blue)",
        whole=True,
        text="one or more lists of 3 numbers, each 0 to 1",
    )


@dataclass(frozen=True)
class _Limits:
    """Bounds of a number: from `low` to `high`, greater than `above`, less than `below`."""

    low: float = -math.inf
    high: float = math.inf
    above: float = -math.inf
    below: float = math.inf

    def hold(self, value: float) -> bool:
        """Whether a number is finite and within them."""
        inside = self.low <= value <= self.high and self.above < value < self.below
        return inside and math.isfinite(value)

    @property
    def words(self) -> str:
        """Such as "be above 0" or "lie between 0 and 1"."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"lie {self.phrase}"
        return f"be {self.phrase or 'finite'}"

    @property
    def phrase(self) -> str:
        """Such as "above 0" or "between 0 and 1"; empty without bounds."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"between {_shown(self.low)} and {_shown(self.high)}"
        named = ("at least", self.low), ("above", self.above), ("below", self.below)
        return " and ".join(
            f"{name} {_shown(bound)}"
            for name, bound in (*named, ("at most", self.high))
            if math.isfinite(bound)
        )

    @property
    def text(self) -> str:
        """Such as "> 0" or "0 to 1"."""
        if math.isfinite(self.low) and math.isfinite(self.high):
            return f"{_shown(self.low)} to {_shown(self.high)}"
        named = (">=", self.low), (">", self.above), ("<", self.below), ("<=", self.high)
        shown = [f"{sign} {_shown(bound)}" for sign, bound in named if math.isfinite(bound)]
        return ", ".join(shown) or "finite"


def _shown(bound: float) -> str:
    """A bound as it is typed: whole numbers without a point."""
    return str(int(bound)) if bound == int(bound) else str(bound)


def range_text(of: Field[Any]) -> str:
    """The range of a config field for a table, such as "> 0", "0 to 1" or "one of cpu, cuda".

    Empty for a field without one: text, paths, switches and nested configs.
    """
    allowed: Range | None = of.metadata.get("range")
    if allowed is None:
        return ""
    each = "each " if "list[" in str(of.type) and not allowed.whole else ""
    return each + allowed.text + (", or null" if "None" in str(of.type) else "")


# ------------------------------------------------------------------ their checks


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


def _is_full(value: Any) -> bool:
    """Whether neither a list nor any list in it is empty."""
    return not isinstance(value, list) or (len(value) > 0 and all(map(_is_full, value)))


def lookup(registry: Mapping[str, T], key: str, name: str) -> T:
    """Return the entry `name` of a registry; `key` is the config key that holds the name.

    Raises:
        SdfgcnError: There is no such entry.
    """
    if name not in registry:
        raise SdfgcnError(f"{key} is '{name}', but must be one of {', '.join(sorted(registry))}.")
    return registry[name]
