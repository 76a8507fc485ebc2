"""Masks and matches from RGB pictures alone (paper section V A)."""

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
    """Segments the scene and the goal, and matches their objects by appearance.

    Goal rows are the goal's detections, largest first. A current detection takes the row of its
    matched goal object, and so keeps its row as long as the match stays the same. Unmatched
    detections take the free rows.
    """

    def __init__(self, config: PerceptionConfig, max_objects: int):
        """Load the networks.

        Raises:
            SdfgcnError: There is no such segmenter or encoder, or its weights cannot be loaded.
        """
        super().__init__(config, max_objects)
        segmentation = config.segmentation
        self._segment = SEGMENTERS.find(segmentation.name)(segmentation)
        self._matcher = Matcher(config.encoder)
        self._goal_features = np.zeros((0, self._matcher.n_features), dtype=np.float32)

    def see_goal(self, view: View) -> NDArray[np.bool_]:
        """[n, H, W] the masks found in the goal picture."""
        pixels = view.pixels()
        masks = self._find(pixels)
        self._goal_features = self._matcher.features(pixels, masks)
        return masks

    def see(self, view: View) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Masks of the current picture, each in the row of its goal object if matched."""
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
        """[m, H, W] masks, largest first, at most `max_objects`."""
        masks = self._segment(pixels)
        largest = np.argsort(-masks.sum(axis=(1, 2)), kind="stable")
        return masks[largest[: self.max_objects]]


def rows_of(matches: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """The row of each detection: its match, or else the first free row.

    Args:
        matches: [m] distinct goal rows, -1 for unmatched detections.
        n: Number of goal rows.

    Returns:
        [m] distinct rows below max(m, n).
    """
    rows = matches.copy()
    free = np.setdiff1d(np.arange(max(len(matches), n)), matches)
    lost = matches < 0
    rows[lost] = free[: lost.sum()]
    return rows
