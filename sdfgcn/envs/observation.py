"""What an environment's observation is put together from."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from sdfgcn.perception.oracle import oracle_masks
from sdfgcn.sim.renderer import Renderer
from sdfgcn.sim.task import RearrangementTask


class View:
    """What there is to see at this moment; rendered when it is asked for, and only once."""

    def __init__(self, renderer: Renderer, task: RearrangementTask):
        self._renderer = renderer
        self._task = task
        self._pixels: NDArray[np.uint8] | None = None

    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] the RGB picture."""
        if self._pixels is None:
            self._pixels = self._renderer.pixels()
        return self._pixels

    def true_masks(self) -> NDArray[np.bool_]:
        """[n, H, W] one mask per object of the episode, by the renderer's segmentation.

        All false where an object is hidden.
        """
        task = self._task
        return oracle_masks(self._renderer.geom_ids(), task.slot_of_geom, len(task.episode.objects))


def nearest_objects(center: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.float64]:
    """The true centres of what detections show.

    Args:
        center: [m, 2] detected centres, metres.
        true: [n, 2] the objects' true centres, metres.

    Returns:
        [m, 2] for each detection the object nearest to it, no two the same one (least total
        distance); a detection too many keeps its own centre.
    """
    position = center.copy()
    distances = np.linalg.norm(center[:, None] - true[None], axis=-1)
    detections, objects = linear_sum_assignment(distances)
    position[detections] = true[objects]
    return position


def by_row(values: NDArray[np.float64], found: NDArray[np.bool_]) -> NDArray[np.float32]:
    """One row per node from one per detection; zero where nothing is detected."""
    spread = np.zeros((len(found), *values.shape[1:]), dtype=np.float32)
    spread[found] = values
    return spread


def padded(rows: NDArray, n: int, fill: int = 0) -> torch.Tensor:
    """The rows as a tensor, followed by rows of `fill` up to n."""
    result = np.full((n, *rows.shape[1:]), fill, dtype=rows.dtype)
    result[: len(rows)] = rows
    return torch.from_numpy(result)
