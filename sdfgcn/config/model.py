"""What picks the push: the base of every config dataclass of `conf/model/`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sdfgcn.config.base import ComponentConfig, check_ranges

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config


@dataclass
class ModelConfig(ComponentConfig):
    """Which method picks the push (`conf/model/`); each extends it with its own keys."""


@dataclass
class QNetworkConfig(ModelConfig):
    """A Q-network: a method that is trained, or evaluated from a checkpoint."""

    def check(self, config: Config) -> None:
        """See `ComponentConfig`."""
        self.check_network(config.env.arena.image_size)

    def check_network(self, image_size: int) -> None:
        """Check what a network of this config needs; a trained one is loaded knowing no more.

        `image_size` is the height and width of the picture, pixels.

        Raises:
            SdfgcnError: One sentence that names the key, the value seen and what would work.
        """
        check_ranges(self, "model")
