"""The network of unseen object clustering: a unit embedding for each pixel (Xiang et al. 2020).

The network is small, because it runs at every push: an encoder-decoder at a half to an eighth of
the picture resolution, and a convolution before and after it at full resolution, which keeps edges
sharp to the pixel. Pixel coordinates are part of the input, so that identical objects can be told
apart by position (the authors' network uses the points of a depth image instead).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate, normalize, pixel_shuffle

from sdfgcn.errors import SdfgcnError

GROUPS = 8  # of group normalisation; batch statistics would make a picture depend on its batch


class UCN(nn.Module):
    """Embeds each pixel of a picture on the unit sphere."""

    def __init__(self, channels: int, widths: Sequence[int], embedding: int) -> None:
        """Create the layers.

        Args:
            channels: Channels at full resolution.
            widths: Channels at a half of it, a quarter and so on.
            embedding: D, the dimension of the embeddings.

        Raises:
            SdfgcnError: `widths` is empty, or a width is not a multiple of `GROUPS`.
        """
        super().__init__()
        uneven = [width for width in widths if width % GROUPS or width <= 0]
        if uneven or not widths:
            raise SdfgcnError(
                f"env.perception.segmentation.widths is {list(widths)}, but must list at least one "
                f"width, each a multiple of {GROUPS}."
            )
        self.stride = 2 ** len(widths)
        self.stem = nn.Sequential(nn.Conv2d(5, channels, 3, padding=1), nn.ReLU())
        inputs = [channels, *widths[:-1]]
        self.encoder = nn.ModuleList(
            nn.Sequential(_block(a, b, stride=2), _block(b, b))
            for a, b in zip(inputs, widths, strict=True)
        )
        pairs = list(zip(widths[1:], widths[:-1], strict=True))
        self.lateral = nn.ModuleList(nn.Conv2d(a, b, 1) for a, b in pairs)
        self.decoder = nn.ModuleList(_block(b, b) for _, b in pairs)
        self.widen = nn.Conv2d(widths[0], 4 * channels, 1)  # each cell becomes four pixels
        self.head = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(channels, embedding, 1),
        )
        # channels_last is a third faster on a CPU.
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, pictures: Tensor) -> Tensor:
        """Embed every pixel.

        Args:
            pictures: [B, 3, H, W] RGB, 0 to 1; H and W are multiples of `stride`.

        Returns:
            [B, D, H, W] embeddings of length 1.
        """
        sharp = features = self.stem(_with_coordinates(pictures))
        levels = []
        for stage in self.encoder:
            features = stage(features)
            levels.append(features)
        for k in reversed(range(len(self.decoder))):
            features = interpolate(self.lateral[k](features), scale_factor=2.0, mode="nearest")
            features = self.decoder[k](features + levels[k])
        # pixel_shuffle drops channels_last, which would slow down the rest by a quarter.
        fine = pixel_shuffle(self.widen(features), 2).contiguous(memory_format=torch.channels_last)
        return normalize(self.head(sharp + fine), dim=1)


def _block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False),
        nn.GroupNorm(GROUPS, outputs),
        nn.ReLU(),
    )


def _with_coordinates(pictures: Tensor) -> Tensor:
    """[B, 5, H, W]: colours centred on zero, and each pixel's column and row from -1 to 1."""
    batch, _, height, width = pictures.shape
    u = torch.linspace(-1.0, 1.0, width).expand(batch, 1, height, width)
    v = torch.linspace(-1.0, 1.0, height)[:, None].expand(batch, 1, height, width)
    joined = torch.cat([4.0 * (pictures - 0.5), u, v], dim=1)
    return joined.contiguous(memory_format=torch.channels_last)
