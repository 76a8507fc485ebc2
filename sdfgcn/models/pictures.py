"""Pictures of objects as network input, and the config of convolutional networks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from omegaconf import MISSING
from torch import Tensor

from sdfgcn.config import QNetworkConfig, lookup, number, one_of, several
from sdfgcn.errors import SdfgcnError
from sdfgcn.models.layers import check_widths


def scaled_sdf(sdf: Tensor, unit: float) -> Tensor:
    """Scale signed distances to multiples of `unit` pixels, then subtract 1; in place.

    Distances far from an object are about one unit, and all-positive inputs slow down learning.
    """
    return sdf.mul_(1.0 / unit).sub_(1.0)


def object_mask(sdf: Tensor, unit: float) -> Tensor:
    """1 inside the object, 0 outside; in place."""
    return sdf.lt_(0.0)


# Named functions, not lambdas: networks are pickled for collectors in other processes.
PICTURES: dict[str, Callable[[Tensor, float], Tensor]] = {
    "sdf": scaled_sdf,
    "mask": object_mask,
}


@dataclass
class ConvWidthConfig:
    """The width of the convolutions; lists have one entry per CNN block.

    Attributes:
        channels: Output channels of each convolution of the block.
        strides: Stride of each convolution of the block.
        pooling: Size and stride of the max pooling at the end of the block; 1 is none.
        hidden: Units between the last two linear layers.
    """

    channels: list[list[int]] = several(1, 4096)
    strides: list[list[int]] = several(1, 64)
    pooling: list[int] = several(1, 64)
    hidden: int = number(1, 16_384)

    def final_size(self, image_size: int) -> int:
        """Height and width of the blocks' output for a picture of `image_size`, pixels."""
        for strides, pooling in zip(self.strides, self.pooling, strict=True):
            for stride in strides:
                image_size = (image_size - 1) // stride + 1  # 3x3 convolutions, padded
            image_size //= pooling
        return image_size


@dataclass
class ConvConfig(QNetworkConfig):
    """A Q-network over pictures.

    Attributes:
        features: The content of a picture, a key of `PICTURES`.
        sdf_unit: The distance that maps to 0 and is the unit of scaling, as a share of the
            picture's height.
        width: The key of `widths` to use.
        widths: The available widths.
    """

    features: str = one_of(*PICTURES)
    sdf_unit: float = number(0.001, 1000)
    width: str = MISSING
    widths: dict[str, ConvWidthConfig] = MISSING

    def check_network(self, image_size: int) -> None:
        """See `QNetworkConfig`."""
        super().check_network(image_size)
        width = lookup(self.widths, "model.width", self.width)
        key = f"model.widths.{self.width}"
        check_widths(f"{key}.channels", width.channels, width.channels)
        check_widths(f"{key}.strides", width.strides, width.channels)
        check_widths(f"{key}.pooling", [width.pooling], [width.channels])
        if width.final_size(image_size) < 1:
            raise SdfgcnError(
                f"{key}.strides {width.strides} and pooling {width.pooling} leave nothing of a "
                f"picture of env.arena.image_size {image_size}; take smaller ones or a larger "
                "picture."
            )
