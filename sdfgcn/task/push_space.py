"""The space of pushes: which there are, how an action stands for one, and where each starts.

An action is one index: the row of the object to push, times the number of directions, plus the
direction. Direction k of D heads 360 k / D degrees counter-clockwise from the table's x axis.

The start of a push lies on the line through the object's centre: from the centre back against
the push direction to free space (paper section IV c). Everything comes from masks, their SDFs and
the camera's geometry, never from true poses.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from torch import Tensor
from torchrl.data import Categorical

from sdfgcn.config import ArenaConfig, PushConfig
from sdfgcn.task.camera import CameraModel, camera_model
from sdfgcn.task.region import Region
from sdfgcn.task.world import PushCommand

MAX_SEARCH = 0.25  # metres back from the centre: past the largest object and one behind it


@dataclass(frozen=True)
class PushPlan:
    """Every push that a picture offers, for its m detected objects and D directions.

    Attributes:
        center: [m, 2] the centre of each mask on the table, metres.
        start: [m, D, 2] where the tool comes down, metres; NaN where the push is not legal.
        free: [m, D] distance from there to the first surface ahead, metres.
        legal: [m, D] whether free space was found within the tool's bounds.
    """

    center: NDArray[np.float64]
    start: NDArray[np.float64]
    free: NDArray[np.float64]
    legal: NDArray[np.bool_]


class PushSpace:
    """The D push directions, their actions, and where each push of a picture starts.

    Attributes:
        n_directions: D.
        angles: [D] where each direction heads, radians counter-clockwise from the x axis.
        camera: The camera that takes the pictures.
    """

    def __init__(self, config: PushConfig, arena: ArenaConfig) -> None:
        """Prepare what is the same for every picture."""
        n = config.directions
        self.n_directions = n
        self.angles = np.array([2.0 * np.pi * k / n for k in range(n)])
        # Mirrored at x = 0, what heads at an angle a heads at 180 degrees - a.
        self._mirrored = torch.tensor([(n // 2 - k) % n for k in range(n)])
        self.camera: CameraModel = camera_model(arena)
        self._config = config
        self._reach = Region.reach(arena)
        back = np.arange(0.0, MAX_SEARCH, config.search_step)
        self._step = np.arange(len(back))
        ahead = np.array([[np.cos(angle), np.sin(angle)] for angle in self.angles])
        # [D, S, 3]: S points on each line, ever further behind an object at the origin.
        self._behind = np.zeros((n, len(back), 3))
        self._behind[..., :2] = -back[:, None] * ahead[:, None, :]

    # ------------------------------------------------------------------ actions

    def encode(self, row: int, direction: int) -> int:
        """The action that pushes the object in `row`."""
        return row * self.n_directions + direction

    def decode(self, action: int) -> tuple[int, int]:
        """The row and the direction of an action."""
        return divmod(action, self.n_directions)

    def degrees(self, direction: int) -> float:
        """Where a direction heads, degrees counter-clockwise from the x axis."""
        return 360.0 * direction / self.n_directions

    def spec(self, rows: int) -> Categorical:
        """The spec of an action with so many rows."""
        return Categorical(rows * self.n_directions, shape=(), dtype=torch.int64)

    def by_direction(self, values: Tensor) -> Tensor:
        """[..., N, D] from values [..., N * D] of every action."""
        return values.unflatten(-1, (-1, self.n_directions))

    def nearest(self, offset: NDArray[np.float64]) -> NDArray[np.int64]:
        """Rank the directions [D] by their angle to an offset [2] on the table, nearest first."""
        turn = 2 * np.pi / self.n_directions
        angle = np.arctan2(offset[1], offset[0])
        gap = (np.arange(self.n_directions) * turn - angle + np.pi) % (2 * np.pi) - np.pi
        return np.argsort(np.abs(gap), kind="stable")

    def mirrored(self, values: Tensor) -> Tensor:
        """Values [..., N * D] of every action, as the scene mirrored at x = 0 has them."""
        return self.by_direction(values)[..., self._mirrored].flatten(-2)

    def mirrored_action(self, action: Tensor) -> Tensor:
        """The actions, int64 of any shape, that do the same in the mirrored scene."""
        direction = action % self.n_directions
        return action - direction + self._mirrored[direction]

    def turned(self, values: Tensor, steps: int) -> Tensor:
        """Values [..., N * D] of every action, as the scene turned by `steps` directions has them.

        The scene turns counter-clockwise about the vertical, by 360 / D degrees a step.
        """
        return self.by_direction(values).roll(steps, dims=-1).flatten(-2)

    # ------------------------------------------------------------------ pushes of a picture

    def centers(self, masks: NDArray[np.bool_]) -> NDArray[np.float64]:
        """[m, 2] the centre of each of the [m, H, W] masks on the table, metres; none is empty."""
        m, height, width = masks.shape
        # Whole and half numbers this small are exact in single precision.
        sums = masks.reshape(m, height * width).astype(np.float32) @ _moments(height, width)
        middle = sums[:, 1:] / sums[:, :1].astype(float)
        return self.camera.back_project(middle, self._config.plane_height)[..., :2]

    def plan(self, masks: NDArray[np.bool_], sdfs: NDArray[np.float32]) -> PushPlan:
        """Find where the push of every object in every direction starts.

        The [m, H, W] masks are not empty; `sdfs` are their signed distance fields, pixels.
        """
        m = len(masks)
        if m == 0:
            empty = np.zeros((0, self.n_directions))
            starts = np.zeros((0, self.n_directions, 2))
            return PushPlan(np.zeros((0, 2)), starts, empty, empty.astype(bool))
        camera, config, step = self.camera, self._config, self._step
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

    def command(
        self, plan: PushPlan, detected: NDArray[np.bool_], row: int, direction: int
    ) -> PushCommand:
        """The push of the object in a row, ready to be executed.

        Args:
            plan: Of the m detected objects.
            detected: bool [k] which rows hold one.
            row: A row; where it holds no object, the command's start is NaN.
            direction: Where to push it.
        """
        start, free = np.full(2, np.nan), 0.0
        if row < len(detected) and detected[row]:
            node = int(detected[:row].sum())
            start, free = plan.start[node, direction], float(plan.free[node, direction])
        return PushCommand(start, float(self.angles[direction]), free)

    def action_mask(self, plan: PushPlan, detected: NDArray[np.bool_], rows: int) -> Tensor:
        """Which actions are legal.

        Samplers and losses need one legal action everywhere, also in a terminal state: objects
        that are boxed in may be tried in vain, and where nothing is detected, row 0 stands in.

        Args:
            plan: Of the m detected objects.
            detected: bool [k] which rows hold one.
            rows: N, how many rows an observation has.

        Returns:
            bool [N * D], never all false.
        """
        mask = np.zeros((rows, self.n_directions), dtype=bool)
        found = np.flatnonzero(detected)
        mask[found] = plan.legal
        if not mask.any():
            mask[found if len(found) else 0] = True
        return torch.from_numpy(mask.ravel())


@functools.cache
def _moments(height: int, width: int) -> NDArray[np.float32]:
    """[H * W, 3] what each pixel adds to a mask's area and to its sums of columns and rows."""
    rows, columns = np.indices((height, width)) + 0.5
    return np.stack([np.ones_like(rows), columns, rows], axis=-1).reshape(-1, 3).astype(np.float32)


def _sample(fields: NDArray, pixels: NDArray, layers: NDArray) -> NDArray[np.float64]:
    """Bilinear samples of [L, H, W] fields, continued past their edges by the values there.

    Args:
        fields: [L, H, W].
        pixels: [m, D, S, 2] where (u, v).
        layers: [..., m] which of the fields for each of the m.

    Returns:
        [..., m, D, S].
    """
    _, height, width = fields.shape
    # One field below the other, so that the interpolation has two dimensions and not three.
    rows = np.clip(pixels[..., 1] - 0.5, 0.0, height - 1.0) + height * layers[..., None, None]
    columns = np.broadcast_to(pixels[..., 0] - 0.5, rows.shape)
    return map_coordinates(
        fields.reshape(-1, width), np.stack([rows, columns]), order=1, mode="nearest"
    )
