"""Masks and matches from the RGB picture alone (paper section V A)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import PerceptionConfig
from sdfgcn.perception.base import Perception
from sdfgcn.perception.matching import Matcher
from sdfgcn.registry import PERCEPTIONS, SEGMENTERS
from sdfgcn.task.world import View


@PERCEPTIONS.register("vision")
class VisionPerception(Perception):
    """Segments both pictures and matches their objects by what they look like.

    Goal rows are the goal's detections, the largest first. A detection of the current picture
    takes the row of the goal that it is matched with, so that it keeps its row while it is matched
    alike; a detection too many takes a row that is left over.
    """

    def __init__(self, config: PerceptionConfig, max_objects: int):
        """Load the networks.

        Raises:
            SdfgcnError: There is no such segmenter or encoder, or its weights cannot be had.
        """
        super().__init__(config, max_objects)
        segmentation = config.segmentation
        self._segment = SEGMENTERS.find(segmentation.name)(segmentation)
        self._matcher = Matcher(config.encoder)
        self._goal_features = np.zeros((0, self._matcher.n_features), dtype=np.float32)

    def see_goal(self, view: View) -> NDArray[np.bool_]:
        """[n, H, W] the masks found in the goal's picture."""
        pixels = view.pixels()
        masks = self._find(pixels)
        self._goal_features = self._matcher.features(pixels, masks)
        return masks

    def see(self, view: View) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """The masks found in the current picture, each in its goal's row if it has one."""
        pixels = view.pixels()
        found = self._find(pixels)
        matches = self._matcher.match(self._matcher.features(pixels, found), self._goal_features)
        rows = rows_of(matches, len(self._goal_features))
        n = max(len(found), len(self._goal_features))
        masks = np.zeros((n, *pixels.shape[:2]), dtype=bool)
        matched = np.zeros(n, dtype=bool)
        masks[rows], matched[rows] = found, matches >= 0
        return masks, matched

    def _find(self, pixels: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """[m, H, W] the largest masks first, no more than there are rows."""
        masks = self._segment(pixels)
        largest = np.argsort(-masks.sum(axis=(1, 2)), kind="stable")
        return masks[largest[: self.max_objects]]


def rows_of(matches: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """The row of each detection: its match, or the first that is left over.

    `matches` [m] are rows of the n of the goal, none twice; -1 for none.

    Returns:
        [m] rows, none twice, below the larger of m and n.
    """
    rows = matches.copy()
    free = np.setdiff1d(np.arange(max(len(matches), n)), matches)
    lost = matches < 0
    rows[lost] = free[: lost.sum()]
    return rows
