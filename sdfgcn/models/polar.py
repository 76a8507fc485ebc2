"""Signed distances on the table around each object, in polar coordinates.

A turn of the world by one angle shifts the map by one column, and a mirror image reverses the
columns, so a network of convolutions that are circular along the angle is equivariant.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d, grid_sample, pad

from sdfgcn.config import ArenaConfig
from sdfgcn.task.camera import camera_model
from sdfgcn.task.region import Region


class PolarMaps(nn.Module):
    """Samples the SDFs of a picture on rings around objects on the table.

    Ring 0 is the object's centre; column a heads 360 a / `angles` degrees counter-clockwise from
    the table's x axis.
    """

    def __init__(
        self, arena: ArenaConfig, plane_height: float, rings: int, angles: int, radius: float
    ):
        """Precompute what does not depend on the picture.

        Args:
            arena: Holds the camera and the allowed region.
            plane_height: Height above the table of the plane onto which pixels are projected,
                metres.
            rings: R, rings from the centre to `radius`, evenly spaced.
            angles: A, points on each ring.
            radius: Of the last ring, metres.
        """
        super().__init__()
        self.camera = camera_model(arena)
        self._height = plane_height
        turn = torch.arange(angles) * (2.0 * math.pi / angles)
        distance = torch.linspace(0.0, radius, rings)[:, None]
        around = torch.stack([distance * turn.cos(), distance * turn.sin()], dim=-1)
        region = Region.range(arena)
        for name, value in (
            ("around", around),  # [R, A, 2] metres
            ("eye", torch.from_numpy(self.camera.position)),
            ("axes", torch.from_numpy(self.camera.rotation)),
            ("low", torch.from_numpy(region.low)),
            ("high", torch.from_numpy(region.high)),
        ):
            self.register_buffer(name, value.float(), persistent=False)

    def points(self, center: Tensor) -> Tensor:
        """The points [*B, R, A, 2] on the table around [*B, 2], metres."""
        return center[..., None, None, :] + self.around  # type: ignore[operator]

    def distances(self, sdf: Tensor, points: Tensor, shift: Tensor | None = None) -> Tensor:
        """Signed distances at points on the table.

        Args:
            sdf: [B, K, H, W] signed distance fields, pixels.
            points: [B, I, R, A, 2] points, metres.
            shift: [B, K, 2] how far each object has moved since the picture, metres; None if none
                has.

        Returns:
            [B, I, K, R, A] metres, negative inside. Beyond the picture's edge, those of the edge.
        """
        if shift is not None:  # each object is a picture of its own, seen from points of its own
            points = (points[:, None] - shift[:, :, None, None, None]).flatten(0, 1)
            values = self.distances(sdf.flatten(0, 1)[:, None], points)
            return values.squeeze(2).unflatten(0, sdf.shape[:2]).transpose(1, 2)
        pixels, scale = self._projected(points)
        batch, n, rings, angles, _ = points.shape
        grid = (2.0 / self.camera.size * pixels - 1.0).reshape(batch, n * rings, angles, 2)
        values = grid_sample(sdf, grid, padding_mode="border", align_corners=False)
        values = values.unflatten(2, (n, rings)).transpose(1, 2)
        return values / scale[:, :, None]

    def inside_by(self, points: Tensor) -> Tensor:
        """Signed distance [*B] of points [*B, 2] to the border of the allowed region, metres.

        Positive inside.
        """
        return torch.minimum(points - self.low, self.high - points).amin(dim=-1)  # type: ignore[operator]

    def _projected(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """As `CameraModel.project_scaled`, of points in the plane, [*B, 2]."""
        world = pad(points, (0, 1), value=self._height)
        local = (world - self.eye) @ self.axes  # type: ignore[operator]
        scale = self.camera.focal / -local[..., 2]
        flipped = torch.stack([local[..., 0], -local[..., 1]], dim=-1)
        return flipped * scale[..., None] + 0.5 * self.camera.size, scale


def reflected(maps: Tensor) -> Tensor:
    """Polar maps [..., A] mirrored in the line through the centre along column 0."""
    return maps.flip(-1).roll(1, dims=-1)


class PolarConv(nn.Module):
    """A 3x3 convolution over polar maps, circular along the angle, followed by a ReLU."""

    def __init__(self, n_inputs: int, n_outputs: int, stride: tuple[int, int] = (1, 1)):
        """Make the weights; `stride` is by rings and by angles."""
        super().__init__()
        self.conv = nn.Conv2d(n_inputs, n_outputs, 3, stride)

    def forward(self, maps: Tensor) -> Tensor:
        """Convolve [P, C, R, A]."""
        conv = self.conv
        around = pad(maps, (1, 1, 0, 0), mode="circular")
        return conv2d(around, conv.weight, conv.bias, conv.stride, padding=(1, 0)).relu_()


def in_all_directions(maps: Tensor, n_directions: int) -> Tensor:
    """What can be seen from the centre when looking in each direction.

    Args:
        maps: [P, C, R, A] features.
        n_directions: D, a divisor of A.

    Returns:
        [P, D, 3 C R]: for each direction, the features ahead, those behind, and the mean of all
        around.
    """
    columns = maps.flatten(1, 2)
    ahead = columns[..., :: columns.shape[-1] // n_directions]
    behind = ahead.roll(n_directions // 2, dims=-1)
    around = columns.mean(dim=-1, keepdim=True).expand_as(ahead)
    return torch.cat([ahead, behind, around], dim=1).transpose(1, 2)
