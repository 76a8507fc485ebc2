"""The pinhole camera: from world points to pixels and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdfgcn.config import ArenaConfig


@dataclass(frozen=True)
class CameraModel:
    """A fixed camera with a square picture, in MuJoCo's convention.

    Pixel coordinates are continuous: the picture covers [0, size] x [0, size], (0, 0) is the
    outer corner of the top-left pixel, and the centre of the pixel in row r and column c lies
    at (u, v) = (c + 0.5, r + 0.5).

    Attributes:
        position: [3] the optical centre, metres, world frame.
        rotation: [3, 3] the columns are the camera's axes in the world frame: x to the right in
            the picture, y up in the picture, z backward. The camera looks along -z.
        fovy: Vertical field of view, radians.
        size: Height and width of the picture, pixels.
    """

    position: NDArray[np.float64]
    rotation: NDArray[np.float64]
    fovy: float
    size: int

    @property
    def focal(self) -> float:
        """Focal length, pixels."""
        return 0.5 * self.size / float(np.tan(0.5 * self.fovy))

    def project(self, points: ArrayLike) -> NDArray[np.float64]:
        """Project world points [..., 3], metres, into the picture.

        Returns:
            [..., 2] column u and row v, pixels; not clipped to the picture. A point that is not
            in front of the camera gives NaN.
        """
        return self.project_scaled(points)[0]

    def project_scaled(self, points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Like `project`, and with the scale of the picture at each point.

        Returns:
            [..., 2] as from `project`, and [...] pixels per metre across the line of sight.
        """
        local = (np.asarray(points, dtype=np.float64) - self.position) @ self.rotation
        depth = -local[..., 2]
        scale = self.focal / np.where(depth > 0.0, depth, np.nan)
        pixels = local[..., :2] * scale[..., None]
        pixels[..., 1] *= -1.0
        return pixels + 0.5 * self.size, scale

    def back_project(self, pixels: ArrayLike, height: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Where the ray through each pixel meets a horizontal plane.

        Args:
            pixels: [..., 2] column u and row v, pixels.
            height: z of the plane, metres, world frame; a number, or one per pixel.

        Returns:
            [..., 3] world points, metres. A ray that does not meet the plane in front of the
            camera gives NaN.
        """
        uv = np.asarray(pixels, dtype=np.float64)
        x = (uv[..., 0] - 0.5 * self.size) / self.focal
        y = (0.5 * self.size - uv[..., 1]) / self.focal
        rays = np.stack([x, y, -np.ones_like(x)], axis=-1) @ self.rotation.T
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = (np.asarray(height) - self.position[2]) / rays[..., 2]
        scale = np.where(np.isfinite(scale) & (scale > 0.0), scale, np.nan)
        points = self.position + scale[..., None] * rays
        # Exactly on the plane, not within rounding of it.
        points[..., 2] = np.where(np.isnan(scale), np.nan, height)
        return points


def camera_model(arena: ArenaConfig) -> CameraModel:
    """The camera that the config describes.

    It is on the robot's side of the table (the paper's camera is on the wrist), tilted from
    straight down; up in the picture is +y, right is +x.

    Returns:
        The camera, aimed at `camera_target` from `camera_distance` metres.
    """
    tilt = np.radians(arena.camera_tilt)
    backward = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    right = np.array([1.0, 0.0, 0.0])
    target = np.array([*arena.camera_target, 0.0])
    return CameraModel(
        position=target + arena.camera_distance * backward,
        rotation=np.stack([right, np.cross(backward, right), backward], axis=-1),
        fovy=float(np.radians(arena.camera_fovy)),
        size=arena.image_size,
    )
