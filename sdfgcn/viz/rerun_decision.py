"""The decisions of a rerun recording: what an agent weighed and expected when it chose a push."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sdfgcn.config import EnvConfig
from sdfgcn.envs.records import Snapshot, StepRecord
from sdfgcn.viz.colors import Color
from sdfgcn.viz.heat_map import heat_map
from sdfgcn.viz.rerun_arrows import SEEN_MOVE, WHITE, moves_2d, moves_3d, rings_2d, values_2d
from sdfgcn.viz.rerun_drawing import markdown, png
from sdfgcn.viz.rerun_scene import Log, SceneDrawing
from sdfgcn.viz.shapes import top
from sdfgcn.viz.words import q_table, score_table

# What belongs to a push and is gone at the end of the episode.
OF_A_PUSH = (
    "world/push",
    "world/expected",
    "world/moved",
    "world/camera/values",
    "world/camera/push",
    "world/camera/expected/moves",
    "world/camera/expected/ring",
    "world/camera/moved",
)


@dataclass(frozen=True)
class Decision:
    """A push, and what stood on the table when it was chosen: rows 0 to m - 1 may hold objects."""

    step: StepRecord
    before: Snapshot
    slots: NDArray[np.intp]
    names: list[str]
    colors: list[Color]

    @property
    def centers(self) -> NDArray[np.float64]:
        """[m, 2] detected centres, metres."""
        return self.before.scene.center.double().numpy()[: len(self.names)]

    @property
    def values(self) -> NDArray[np.float32]:
        """[m, D] action values."""
        assert self.step.q_values is not None
        return np.asarray(self.step.q_values, dtype=np.float32)[: len(self.names)]

    @property
    def legal(self) -> NDArray[np.bool_]:
        """[m, D] the legal pushes of detected objects."""
        seen = self.before.scene.node_mask.numpy()[: len(self.names), None]
        return self.step.legal[: len(self.names)] & seen


class DecisionDrawing:
    """Draws decisions as they come, and at the end what needs all of them."""

    def __init__(self, log: Log, scene: SceneDrawing, env: EnvConfig) -> None:
        """Draw to `log`, in the picture and the colours of a scene."""
        self._log = log
        self._scene = scene
        self._camera = scene.camera
        self._height = env.push.plane_height
        self._valued: list[Decision] = []

    def log(self, decision: Decision) -> None:
        """Log what the agent weighed and expected when it chose the push."""
        step, names = decision.step, decision.names
        if step.q_values is not None:
            self._valued.append(decision)
            self._log("q_values", rr.Tensor(decision.values, dim_names=("row", "direction")))
            if step.push.row < len(names):
                self._log("q_values/table", markdown(q_table(names, step)))
        if step.explanation is None:
            return
        expected = step.explanation.displacement[: len(names)].astype(float)
        self._log_moves(decision, expected, "expected", [WHITE] * len(names))
        rows = np.flatnonzero(np.linalg.norm(expected, axis=1) >= SEEN_MOVE)
        ends, spread = (decision.centers + expected)[rows], step.explanation.deviation[rows]
        rings = rings_2d(ends, spread, self._camera, self._height)
        self._log("world/camera/expected/ring", rings)
        if step.q_values is not None:
            self._log("expected/scores", markdown(score_table(names, step)))

    def log_moved(self, decision: Decision, moved: NDArray[np.float64]) -> None:
        """Log how far the objects moved, [m, 2] metres."""
        self._log_moves(decision, moved, "moved", decision.colors)

    def log_values(self, at: Callable[[int], None]) -> None:
        """Log the values of all pushes on one scale, which only the whole episode determines.

        `at` sets the push to log at.
        """
        shown = [decision.values[decision.legal] for decision in self._valued]
        if not any(map(len, shown)):
            return
        every = np.concatenate(shown)
        limits = float(every.min()), float(every.max())
        camera = self._camera
        for decision in self._valued:
            values, legal, push = decision.values, decision.legal, decision.step.push
            chosen = push.row, push.direction
            names, colors = decision.names, decision.colors
            at(decision.step.index)
            arrows = values_2d(
                decision.centers, values, legal, chosen, limits, camera, self._height
            )
            self._log("world/camera/values", arrows)
            drawn = heat_map(values, legal, chosen, names, colors, limits)
            self._log("q_values/heat_map", png(drawn))

    def _log_moves(
        self, decision: Decision, moved: NDArray, name: str, colors: list[Color]
    ) -> None:
        """Log displacements [m, 2] as arrows in the picture and above the objects."""
        rows = np.flatnonzero(np.nan_to_num(np.linalg.norm(moved, axis=1)) >= SEEN_MOVE)
        camera, centers = self._camera, decision.centers[rows]
        heights = [self._top(decision.before, int(decision.slots[row])) for row in rows]
        colors = [colors[row] for row in rows]
        origins = np.column_stack([centers, heights])
        self._log(f"world/{name}", moves_3d(origins, moved[rows], colors))
        flat = moves_2d(centers, moved[rows], colors, camera, self._height)
        self._log(f"world/camera/{name}{'/moves' * (name == 'expected')}", flat)

    def _top(self, moment: Snapshot, slot: int) -> float:
        """Height at which an arrow clears the object, metres."""
        if moment.poses is None or slot < 0:
            return self._height
        return top(self._scene.objects[slot], moment.poses[slot]) + 0.01
