"""Base class of encoders: pretrained networks whose intermediate stages serve as features."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

from sdfgcn.errors import SdfgcnError

# Statistics of the training pictures; red, green, blue.
IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)

_LEAST_WEIGHT = 1e-4  # of a feature-map cell; keeps the sum positive if a mask vanishes


class Encoder(nn.Module, ABC):
    """A pretrained network whose stages are pooled over the object.

    Middle stages distinguish objects a few pixels across better than logits, because late stages
    were trained on objects that fill the picture.
    """

    def __init__(self, stages: Sequence[int]) -> None:
        """Select the stages to pool, numbered from 1 to `n_stages`.

        Raises:
            SdfgcnError: A stage does not exist, or `stages` is empty.
        """
        super().__init__()
        if not stages or not all(1 <= stage <= self.n_stages for stage in stages):
            raise SdfgcnError(
                f"env.perception.encoder.stages is {list(stages)}, but must list numbers between 1 "
                f"and {self.n_stages}."
            )
        self.stages = tuple(stages)

    @property
    @abstractmethod
    def n_stages(self) -> int:
        """Number of stages of the network."""

    @abstractmethod
    def stem(self, pictures: Tensor) -> Tensor:
        """Layers before the first stage: [B, 3, S, S] -> feature maps."""

    @abstractmethod
    def stage(self, number: int, maps: Tensor) -> Tensor:
        """Stage `number`, counted from 1: feature maps -> feature maps."""

    @torch.inference_mode()
    def forward(self, pictures: Tensor, masks: Tensor) -> list[Tensor]:
        """Pool the chosen stages over the object; later stages are not computed.

        Args:
            pictures: float32 [B, 3, S, S], normalised with ImageNet's mean and standard deviation.
            masks: float32 [B, 1, S, S], 1 on the object.

        Returns:
            For each chosen stage, [B, 2C] mean and standard deviation of its C channels.
        """
        maps = self.stem(pictures.contiguous(memory_format=torch.channels_last))
        pooled: dict[int, Tensor] = {}
        for number in range(1, max(self.stages) + 1):
            maps = self.stage(number, maps)
            if number in self.stages:
                pooled[number] = pool(maps, masks)
        return [pooled[number] for number in self.stages]


def pool(maps: Tensor, masks: Tensor) -> Tensor:
    """[B, 2C] mean and standard deviation of [B, C, h, w] feature maps over [B, 1, S, S] masks."""
    weight = interpolate(masks, maps.shape[-2:], mode="area") + _LEAST_WEIGHT
    weight = weight / weight.sum(dim=(2, 3), keepdim=True)
    mean = (maps * weight).sum(dim=(2, 3), keepdim=True)
    variance = ((maps - mean).square() * weight).sum(dim=(2, 3))
    return torch.cat([mean.flatten(1), variance.sqrt()], dim=1)
