"""What every part of the config shares."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from omegaconf import MISSING

from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config

N_DIRECTIONS = 8  # for what does not use PushSpace yet
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


def check_at_least(least: float, values: Mapping[str, float]) -> None:
    """Check values by key.

    Raises:
        SdfgcnError: One of them is below `least`.
    """
    for key, value in values.items():
        if value < least:
            raise SdfgcnError(f"{key} is {value}, but must be at least {least}.")


def check_above_zero(values: Mapping[str, float]) -> None:
    """Check values by key.

    Raises:
        SdfgcnError: One of them is 0 or below.
    """
    for key, value in values.items():
        if value <= 0:
            raise SdfgcnError(f"{key} is {value}, but must be above 0.")


def check_share(values: Mapping[str, float]) -> None:
    """Check values by key.

    Raises:
        SdfgcnError: One of them is not between 0 and 1.
    """
    for key, value in values.items():
        if not 0.0 <= value <= 1.0:
            raise SdfgcnError(f"{key} is {value}, but must lie between 0 and 1.")


def check_choice(names: Collection[str], values: Mapping[str, str]) -> None:
    """Check values by key.

    Raises:
        SdfgcnError: One of them is none of `names`.
    """
    for key, value in values.items():
        if value not in names:
            raise SdfgcnError(f"{key} is '{value}', but must be one of {', '.join(names)}.")


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
