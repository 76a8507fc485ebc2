"""The scene of a rerun recording: what is constant in an episode, and what stands on the table."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sdfgcn.config import EnvConfig
from sdfgcn.envs.records import EpisodeStart, Snapshot
from sdfgcn.errors import SdfgcnError
from sdfgcn.viz.colors import UNMATCHED_COLOR, Color, object_colors
from sdfgcn.viz.rerun_drawing import (
    GOAL_ALPHA,
    MASK_OPACITY,
    link,
    mesh,
    outlines_2d,
    pinhole,
    png,
    region,
    sdf_image,
    table,
    transform,
)
from sdfgcn.viz.shapes import mask_centre, row_slots, zero_contour
from sdfgcn.viz.words import slot_name


class Log(Protocol):
    """Logs archetypes to an entity, at the current time or static."""

    def __call__(self, path: str, *entity: rr.AsComponents, static: bool = False) -> None:
        """Log them."""


class SceneDrawing:
    """Draws an episode's constants once, and its moments as they come.

    Attributes:
        camera: The camera of the pictures.
        objects: The objects by slot; empty without truth.
        links: The robot's links; empty if the world does not know them.
        radii: [n] largest distance of any vertex from the object's origin, metres; 0 without truth.
    """

    def __init__(self, log: Log, episode: EpisodeStart, env: EnvConfig) -> None:
        """Draw to `log`; regions and success threshold are those of `env`."""
        self._log = log
        self._episode = episode
        self._env = env
        self.camera = episode.camera
        self.objects = () if episode.truth is None else episode.truth.objects
        self.links = () if episode.robot is None else episode.robot.links
        self.radii = np.zeros(episode.n_objects)
        for slot, model in enumerate(self.objects):
            self.radii[slot] = np.linalg.norm(model.vertices, axis=1).max()
        self._colors = object_colors(episode)
        self._drawn_sdfs: dict[int, NDArray[np.float32]] = {}

    def color(self, slot: int) -> Color:
        """The object's colour; slot -1 means no object."""
        return self._colors[slot] if slot >= 0 else UNMATCHED_COLOR

    # ------------------------------------------------------------------ constants

    def log_constants(self) -> None:
        """Log the table, the robot, the objects, the goal, and names and colours of all."""
        self._log_classes()
        self._log_table()
        self._log_camera()
        self._log_robot()
        self._log_objects()
        self._log_goal()
        self._log_series_styles()

    def _log_classes(self) -> None:
        slots = range(self._episode.n_objects)
        classes = [(slot + 1, slot_name(self._episode, slot), self._colors[slot]) for slot in slots]
        classes.append((self._class_id(-1), "unmatched", UNMATCHED_COLOR))
        self._log("/", rr.AnnotationContext([(0, "table", (0, 0, 0, 0)), *classes]), static=True)

    def _class_id(self, slot: int) -> int:
        return int(slot) + 1 if slot >= 0 else self._episode.n_objects + 1

    def _log_table(self) -> None:
        arena = self._env.arena
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log("world/table", table(arena.reach_x, arena.reach_y), static=True)
        spawn = region(arena.spawn_x, arena.spawn_y, color=(200, 200, 200))
        self._log("world/bounds/spawn", spawn, static=True)
        allowed = region(arena.range_x, arena.range_y, color=(220, 60, 60))
        self._log("world/bounds/range", allowed, static=True)

    def _log_camera(self) -> None:
        camera = self.camera
        pose = rr.Transform3D(translation=camera.position, mat3x3=camera.rotation)
        self._log("world/camera", pose, pinhole(camera), static=True)

    def _log_robot(self) -> None:
        for part in self.links:
            self._log(f"world/robot/{part.name}", link(part), static=True)

    def _log_objects(self) -> None:
        truth = self._episode.truth
        if truth is None:
            return
        for slot, model in enumerate(truth.objects):
            color = self._colors[slot]
            self._log(f"world/objects/{slot}", mesh(model, color, skin=True), static=True)
            ghost = mesh(model, (*color, GOAL_ALPHA))
            pose = transform(truth.goal_poses[slot])
            self._log(f"world/goal/{slot}", ghost, pose, static=True)

    def _log_goal(self) -> None:
        goal = self._episode.goal
        slots = row_slots(goal, self.radii, self.camera)
        self._log_picture("goal", goal, slots, static=True)
        strips, colors = [], []
        for row in np.flatnonzero(goal.scene.node_mask.numpy()):
            sdf, slot = goal.scene.sdf[row].numpy(), int(slots[row])
            contour = zero_contour(sdf)
            strips += contour
            colors += [self.color(slot)] * len(contour)
            if slot >= 0:
                self._log_sdf(f"sdf/goal/{slot}", sdf, slot, static=True)
        self._log("world/camera/goal", outlines_2d(strips, colors, 0.35), static=True)

    def _log_series_styles(self) -> None:
        for slot in range(self._episode.n_objects):
            name = slot_name(self._episode, slot)
            style = rr.SeriesLines(names=name, colors=self._colors[slot], widths=2.0)
            self._log(f"distance/{slot}", style, static=True)
        threshold = rr.SeriesLines(names="threshold of success", colors=(128, 128, 128))
        self._log("distance/threshold", threshold, static=True)
        self._log("reward/total", rr.SeriesLines(names="reward", widths=3.0), static=True)

    # ------------------------------------------------------------------ moments

    def log_moment(self, moment: Snapshot, slots: NDArray[np.intp]) -> None:
        """Log picture, masks, poses, and the SDFs that changed; `slots` are those of the rows."""
        self._log_picture("world/camera", moment, slots)
        if moment.poses is not None:
            self.log_poses(moment.poses)
        sdf = moment.scene.sdf.numpy()
        seen = {int(slot): sdf[row].copy() for row, slot in enumerate(slots) if slot >= 0}
        for slot, sdf in seen.items():
            if not np.array_equal(sdf, self._drawn_sdfs.get(slot, np.empty(0))):
                self._log_sdf(f"sdf/scene/{slot}", sdf, slot)
        for slot in self._drawn_sdfs.keys() - seen.keys():
            self._log(f"sdf/scene/{slot}", rr.Clear(recursive=True))
        self._drawn_sdfs = seen

    def log_poses(self, poses: NDArray[np.float64]) -> None:
        """Log the objects' poses [n, 7]."""
        for slot, pose in enumerate(poses):
            self._log(f"world/objects/{slot}", transform(pose))

    def _log_picture(
        self, path: str, moment: Snapshot, slots: NDArray[np.intp], static: bool = False
    ) -> None:
        if moment.pixels is None:
            raise SdfgcnError(
                "The scene has no picture to record (Snapshot.pixels is None); set env.record to "
                "True before the episode is reset."
            )
        labels = np.zeros(moment.pixels.shape[:2], dtype=np.uint8)
        masks, rows = moment.scene.masks.numpy(), np.flatnonzero(moment.scene.node_mask.numpy())
        for row in rows:
            labels[masks[row]] = self._class_id(slots[row])
        self._log(f"{path}/picture", png(moment.pixels), static=static)
        image = rr.SegmentationImage(labels, opacity=MASK_OPACITY, draw_order=10)
        self._log(f"{path}/masks", image, static=static)
        names = rr.Points2D(
            [_below(masks[row]) for row in rows],  # a label is drawn below its point
            labels=[f"#{slots[row]}" if slots[row] >= 0 else "?" for row in rows],
            colors=[self.color(int(slots[row])) for row in rows],
            radii=0.0,
            show_labels=True,
            draw_order=40,
        )
        self._log(f"{path}/names", names, static=static)

    def _log_sdf(
        self, path: str, sdf: NDArray[np.float32], slot: int, static: bool = False
    ) -> None:
        contour = zero_contour(sdf)
        lines = outlines_2d(contour, [self._colors[slot]] * len(contour), 0.4)
        self._log(path, sdf_image(sdf), static=static)
        self._log(f"{path}/contour", lines, static=static)


def _below(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(u, v) in the middle of a mask's lower edge, pixels."""
    return np.array([mask_centre(mask)[0], np.flatnonzero(mask.any(axis=1))[-1] + 1.0])
