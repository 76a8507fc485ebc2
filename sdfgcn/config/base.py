"""What every part of the config shares."""

from __future__ import annotations

from collections.abc import Mapping
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
