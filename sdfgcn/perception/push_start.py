"""Where each push would start, from the picture alone (paper section IV c).

The start of a push lies on the line through the object's centre: from the centre back against
the push direction to free space. Everything comes from masks, their SDFs and the camera's
geometry, never from true poses.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from sdfgcn.config import N_DIRECTIONS, ArenaConfig, PushConfig
from sdfgcn.geometry.camera import CameraModel
from sdfgcn.geometry.region import Region
from sdfgcn.sim.push import direction_vector
from sdfgcn.sim.types import PushCommand

MAX_WALK = 0.25  # metres back from the centre: past the largest object and one behind it


@dataclass(frozen=True)
class PushPlan:
    """Every push that the picture offers, for m nodes and 8 directions.

    Attributes:
        center: [m, 2] the centre of each mask on the table, metres.
        start: [m, 8, 2] where the tool comes down, metres; NaN where the push is not legal.
        free: [m, 8] distance from there to the first surface ahead, metres.
        legal: [m, 8] whether free space was found within the tool's bounds.
    """

    center: NDArray[np.float64]
    start: NDArray[np.float64]
    free: NDArray[np.float64]
    legal: NDArray[np.bool_]

    def command(self, node: int, direction: int) -> PushCommand:
        """The push of `node` in `direction`, ready to be executed."""
        return PushCommand(
            start=self.start[node, direction],
            direction=direction,
            free=float(self.free[node, direction]),
        )


def centers(
    masks: NDArray[np.bool_], camera: CameraModel, plane_height: float
) -> NDArray[np.float64]:
    """[m, 2] the centre of each of the [m, H, W] masks on the table, metres; none may be empty."""
    m, height, width = masks.shape
    # Whole and half numbers this small are exact in single precision.
    sums = masks.reshape(m, height * width).astype(np.float32) @ _moments(height, width)
    return camera.back_project(sums[:, 1:] / sums[:, :1].astype(float), plane_height)[..., :2]


@functools.cache
def _moments(height: int, width: int) -> NDArray[np.float32]:
    """[H * W, 3] what each pixel adds to a mask's area and to its sums of columns and rows."""
    rows, columns = np.indices((height, width)) + 0.5
    return np.stack([np.ones_like(rows), columns, rows], axis=-1).reshape(-1, 3).astype(np.float32)


class PushPlanner:
    """Plans all pushes of all nodes of a picture."""

    def __init__(self, camera: CameraModel, config: PushConfig, arena: ArenaConfig):
        """Prepare what is the same for every picture.

        Args:
            camera: The camera that takes the pictures.
            config: `clearance`, `walk` and `plane_height` in metres.
            arena: `reach_x` and `reach_y` bound the start.
        """
        self._camera = camera
        self._config = config
        self._reach = Region.reach(arena)
        directions = np.stack([direction_vector(k) for k in range(N_DIRECTIONS)])
        back = np.arange(0.0, MAX_WALK, config.search_step)
        self._step = np.arange(len(back))
        # [8, S, 3]: S points on each line, ever further behind an object at the origin.
        self._behind = np.zeros((N_DIRECTIONS, len(back), 3))
        self._behind[..., :2] = -back[:, None] * directions[:, None, :]

    def centers(self, masks: NDArray[np.bool_]) -> NDArray[np.float64]:
        """[m, 2] the centre of each of the [m, H, W] masks, metres; none may be empty."""
        return centers(masks, self._camera, self._config.plane_height)

    def plan(self, masks: NDArray[np.bool_], sdfs: NDArray[np.float32]) -> PushPlan:
        """Plan them.

        Args:
            masks: [m, H, W], none empty.
            sdfs: [m, H, W] their signed distance fields, pixels.
        """
        m = len(masks)
        if m == 0:
            empty = np.zeros((0, N_DIRECTIONS))
            starts = np.zeros((0, N_DIRECTIONS, 2))
            return PushPlan(np.zeros((0, 2)), starts, empty, empty.astype(bool))
        camera, config, step = self._camera, self._config, self._step
        center = self.centers(masks)
        origin = np.column_stack([center, np.full(m, config.plane_height)])
        points = origin[:, None, None] + self._behind
        line = points[..., :2]
        pixels, scale = camera.project_scaled(points)

        # Outside the picture nothing is known to be free, and no object is known to reach there.
        layers = np.concatenate([sdfs, sdfs.min(axis=0)[None]])
        own, union = _sample(layers, pixels, np.array([np.arange(m), np.full(m, m)]))
        inside = ((pixels > 0.0) & (pixels < camera.size)).all(axis=-1)
        own, union = np.where(inside, own, 1.0), np.where(inside, union, -1.0)
        # Behind the object's rearmost part on the line: the centre of a ring is free, but not
        # behind.
        behind = step > np.max(np.where(own <= 0.0, step, 0), axis=-1, keepdims=True)
        clear = (union >= config.clearance * scale) & behind & self._reach.contains(line)
        first = np.argmax(clear, axis=-1)
        # The line must not have left the bounds before: they are convex, so one test is enough.
        legal = clear.any(axis=-1)
        start = np.take_along_axis(line, first[..., None, None], axis=2)[..., 0, :]
        start = np.where(legal[..., None], start, np.nan)
        # Ahead of the start, the nearest occupied point on the line.
        occupied = (union <= 0.0) & (step < first[..., None])
        surface = np.max(np.where(occupied, step, 0), axis=-1)
        free = (first - surface) * config.search_step
        return PushPlan(center=center, start=start, free=free, legal=legal)


def _sample(fields: NDArray, pixels: NDArray, layers: NDArray) -> NDArray[np.float64]:
    """Bilinear samples of [L, H, W] fields, continued past their edges by the values there.

    Args:
        fields: [L, H, W].
        pixels: [m, K, S, 2] where (u, v).
        layers: [..., m] which of the fields for each of the m.

    Returns:
        [..., m, K, S].
    """
    _, height, width = fields.shape
    # One field below the other, so that the interpolation has two dimensions and not three.
    rows = np.clip(pixels[..., 1] - 0.5, 0.0, height - 1.0) + height * layers[..., None, None]
    columns = np.broadcast_to(pixels[..., 0] - 0.5, rows.shape)
    return map_coordinates(
        fields.reshape(-1, width), np.stack([rows, columns]), order=1, mode="nearest"
    )
