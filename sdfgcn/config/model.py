"""The bases of the config dataclasses of `conf/model/`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from sdfgcn.config.base import ComponentConfig, check_ranges

if TYPE_CHECKING:
    from sdfgcn.config.experiment import Config


@dataclass
class ModelConfig(ComponentConfig):
    """The method that picks the push (`conf/model/`); each one adds its own keys.

    Attributes:
        own_curriculum: The option of `conf/curriculum/` that its YAML picks, if it picks one.
    """

    own_curriculum: ClassVar[str] = "off"


@dataclass
class QNetworkConfig(ModelConfig):
    """A Q-network: trained, or evaluated from a checkpoint."""

    def check(self, config: Config) -> None:
        """See `ComponentConfig`."""
        self.check_network(config.env.arena.image_size)

    def check_network(self, image_size: int) -> None:
        """Check the keys that define the network; also called when a trained one is loaded.

        `image_size` is the height and width of the picture, pixels.

        Raises:
            SdfgcnError: One sentence that names the key, its value and what would work.
        """
        check_ranges(self, "model")
