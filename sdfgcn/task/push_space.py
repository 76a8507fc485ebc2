"""The space of pushes: the actions, the pushes they encode, and where each push starts.

An action is one index: row of the object to push * D + direction, for D directions. Direction k
heads 360 k / D degrees counter-clockwise from the table's x axis.

The start of a push lies on the line through the object's centre: from the centre, back against
the push direction, to the first free space (paper section IV c). Pushes are planned from masks,
their SDFs and the camera's geometry, never from true poses.
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

MAX_SEARCH = 0.25  # metres back from the centre: past the largest object and another behind it


@dataclass(frozen=True)
class PushPlan:
    """Every push in a picture, for its m detected objects and D directions.

    Attributes:
        center: [m, 2] the centre of each mask on the table, metres.
        start: [m, D, 2] where the tool comes down, metres; NaN where the push is illegal.
        free: [m, D] distance from the start to the first surface ahead, metres.
        legal: [m, D] whether free space was found within the tool's bounds.
    """

    center: NDArray[np.float64]
    start: NDArray[np.float64]
    free: NDArray[np.float64]
    legal: NDArray[np.bool_]


class PushSpace:
    """The D push directions, their actions, and where each push starts.

    Attributes:
        n_directions: The number D of directions.
        angles: [D] heading of each direction, radians counter-clockwise from the x axis.
        camera: The camera that takes the pictures.
    """

    def __init__(self, config: PushConfig, arena: ArenaConfig) -> None:
        """Precompute what does not depend on the picture."""
        n = config.directions
        self.n_directions = n
        self.angles = np.array([2.0 * np.pi * k / n for k in range(n)])
        # Mirroring at x = 0 turns a heading of a degrees into 180 - a.
        self._mirrored = torch.tensor([(n // 2 - k) % n for k in range(n)])
        self.camera: CameraModel = camera_model(arena)
        self._config = config
        self._reach = Region.reach(arena)
        back = np.arange(0.0, MAX_SEARCH, config.search_step)
        self._step = np.arange(len(back))
        ahead = np.array([[np.cos(angle), np.sin(angle)] for angle in self.angles])
        # [D, S, 3]: S points on each line, further and further behind an object at the origin.
        self._behind = np.zeros((n, len(back), 3))
        self._behind[..., :2] = -back[:, None] * ahead[:, None, :]

    # ------------------------------------------------------------------ actions

    def encode(self, row: int, direction: int) -> int:
        """The action that pushes the object in `row`."""
        return row * self.n_directions + direction

    def decode(self, action: int) -> tuple[int, int]:
        """The row and the direction of an action."""
        return divmod(action, self.n_directions)

    def spec(self, rows: int) -> Categorical:
        """The action spec for `rows` rows."""
        return Categorical(rows * self.n_directions, shape=(), dtype=torch.int64)

    def by_direction(self, values: Tensor) -> Tensor:
        """Reshape values [..., N * D] of every action to [..., N, D]."""
        return values.unflatten(-1, (-1, self.n_directions))

    def nearest(self, offset: NDArray[np.float64]) -> NDArray[np.int64]:
        """Rank the directions [D] by angle to an offset [2] on the table, nearest first."""
        turn = 2 * np.pi / self.n_directions
        angle = np.arctan2(offset[1], offset[0])
        gap = (np.arange(self.n_directions) * turn - angle + np.pi) % (2 * np.pi) - np.pi
        return np.argsort(np.abs(gap), kind="stable")

    def mirrored(self, values: Tensor) -> Tensor:
        """Reorder values [..., N * D] of every action for the scene mirrored at x = 0."""
        return self.by_direction(values)[..., self._mirrored].flatten(-2)

    def mirrored_action(self, action: Tensor) -> Tensor:
        """The equivalent actions in the mirrored scene; int64 of any shape."""
        direction = action % self.n_directions
        return action - direction + self._mirrored[direction]

    def turned(self, values: Tensor, steps: int) -> Tensor:
        """Reorder values [..., N * D] of every action for the scene rotated by `steps` directions.

        The scene rotates counter-clockwise about the vertical, 360 / D degrees per step.
        """
        return self.by_direction(values).roll(steps, dims=-1).flatten(-2)

    # ------------------------------------------------------------------ pushes of a picture

    def centers(self, masks: NDArray[np.bool_]) -> NDArray[np.float64]:
        """[m, 2] centres on the table, metres, of [m, H, W] masks; no mask may be empty."""
        m, height, width = masks.shape
        # Integers and halves this small are exact in single precision.
        sums = masks.reshape(m, height * width).astype(np.float32) @ _moments(height, width)
        middle = sums[:, 1:] / sums[:, :1].astype(float)
        return self.camera.back_project(middle, self._config.plane_height)[..., :2]

    def plan(self, masks: NDArray[np.bool_], sdfs: NDArray[np.float32]) -> PushPlan:
        """Find the start of the push of every object in every direction.

        No mask [m, H, W] may be empty; `sdfs` are their signed distance fields, pixels.
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

        # Outside the picture, no space counts as free and no object extends.
        layers = np.concatenate([sdfs, sdfs.min(axis=0)[None]])
        own, union = _sample(layers, pixels, np.array([np.arange(m), np.full(m, m)]))
        inside = ((pixels > 0.0) & (pixels < camera.size)).all(axis=-1)
        own, union = np.where(inside, own, 1.0), np.where(inside, union, -1.0)
        # The start must be behind the object's rearmost point on the line: the centre of a ring is
        # free, but not behind it.
        behind = step > np.max(np.where(own <= 0.0, step, 0), axis=-1, keepdims=True)
        clear = (union >= config.clearance * scale) & behind & self._reach.contains(line)
        first = np.argmax(clear, axis=-1)
        # The line must not leave the bounds before the start; they are convex, so one test will do.
        legal = clear.any(axis=-1)
        start = np.take_along_axis(line, first[..., None, None], axis=2)[..., 0, :]
        start = np.where(legal[..., None], start, np.nan)
        # The nearest occupied point on the line ahead of the start.
        occupied = (union <= 0.0) & (step < first[..., None])
        surface = np.max(np.where(occupied, step, 0), axis=-1)
        free = (first - surface) * config.search_step
        return PushPlan(center=center, start=start, free=free, legal=legal)

    def command(
        self, plan: PushPlan, detected: NDArray[np.bool_], row: int, direction: int
    ) -> PushCommand:
        """The push of the object in a row, ready to execute.

        Args:
            plan: The plan for the m detected objects.
            detected: bool [k] which rows hold a detected object.
            row: The row to push; if it holds no object, the command's start is NaN.
            direction: Index of the direction.
        """
        start, free = np.full(2, np.nan), 0.0
        if row < len(detected) and detected[row]:
            node = int(detected[:row].sum())
            start, free = plan.start[node, direction], float(plan.free[node, direction])
        return PushCommand(start, float(self.angles[direction]), free)

    def action_mask(self, plan: PushPlan, detected: NDArray[np.bool_], rows: int) -> Tensor:
        """Which actions are legal.

        Samplers and losses need at least one legal action, even in a terminal state. If no push is
        legal, all pushes of the detected objects count as legal; without any, those of row 0.

        Args:
            plan: The plan for the m detected objects.
            detected: bool [k] which rows hold a detected object.
            rows: N, the rows of an observation.

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
    """[H * W, 3] contribution of each pixel to a mask's area, column sum and row sum."""
    rows, columns = np.indices((height, width)) + 0.5
    return np.stack([np.ones_like(rows), columns, rows], axis=-1).reshape(-1, 3).astype(np.float32)


def _sample(fields: NDArray, pixels: NDArray, layers: NDArray) -> NDArray[np.float64]:
    """Bilinear samples of [L, H, W] fields, clamped at the edges.

    Args:
        fields: [L, H, W].
        pixels: [m, D, S, 2] sample positions (u, v).
        layers: [..., m] the field to sample for each of the m objects.

    Returns:
        [..., m, D, S].
    """
    _, height, width = fields.shape
    # The fields are stacked vertically, so that the interpolation is in two dimensions, not three.
    rows = np.clip(pixels[..., 1] - 0.5, 0.0, height - 1.0) + height * layers[..., None, None]
    columns = np.broadcast_to(pixels[..., 0] - 0.5, rows.shape)
    return map_coordinates(
        fields.reshape(-1, width), np.stack([rows, columns]), order=1, mode="nearest"
    )
