"""One episode as a rerun recording (`viz=rerun`); open it with `rerun FILE`.

The timeline "push" counts pushes: 0 is the start, and k shows push k and the scene after it.
Entities, where i is an object's slot:

    world/objects/i, world/goal/i      meshes at their poses; the goal is translucent
    world/push                         the push as an arrow, coloured by its status
    world/table, world/bounds/*        the regions on the table
    world/camera                       pinhole, with children picture, masks, push and goal
    world/camera/graph                 the scene graph's edges, between objects and to their goals
    goal/picture, goal/masks           the goal picture
    sdf/scene/i, sdf/goal/i            signed distances in pixels, with the zero contour below
    distance/i, distance/threshold     metres to the goal, and the success threshold
    reward/total, reward/terms/*       the reward of each push
    outcome/return                     undiscounted return so far
    outcome/success, outcome/out_of_range
    q_values                           [rows, D] Q-values behind the push, if any
    q_values/table                     the same as a table, with legality and the chosen push
    log, summary                       what happened, in words

Without true poses (a world without truth), there are no meshes, names and colours go by row, and
distances are between the detected centres.

Only this file and `rerun_drawing` import rerun.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sdfgcn.config import EnvConfig
from sdfgcn.envs.records import EpisodeStart, Snapshot, StepRecord
from sdfgcn.errors import SdfgcnError
from sdfgcn.viz import Recorder
from sdfgcn.viz.colors import STATUS_COLORS, UNMATCHED_COLOR, slot_color
from sdfgcn.viz.rerun_drawing import (
    GOAL_ALPHA,
    MASK_OPACITY,
    TIMELINE,
    arrow_2d,
    arrow_3d,
    blueprint,
    edges_2d,
    mesh,
    pinhole,
    png,
    region,
    sdf_image,
    table,
    transform,
)
from sdfgcn.viz.shapes import row_slots, zero_contour
from sdfgcn.viz.words import outcome, push_sentence, q_table, row_name, slot_name, summary

# One batch per entity instead of one per push has far less overhead per row.
_BATCHES = rr.ChunkBatcherConfig(flush_tick=3600.0, flush_num_bytes=4 * 2**20)


class RerunRecorder(Recorder):
    """Writes one episode to one .rrd file.

    Each recorder owns its stream and leaves rerun's global state alone. The data goes to
    `<path>.partial`, which `close` renames to `path`, so a file with the final name is complete.
    Create the recorder in the process that uses it; its stream does not survive a fork.
    """

    def __init__(self, path: Path, env: EnvConfig) -> None:
        """Prepare a recording to `path`, an .rrd file; nothing is written before `start`.

        Regions and success threshold are those of `env`.
        """
        self._path = Path(path)
        self._partial = self._path.with_name(self._path.name + ".partial")
        self._env = env
        self._stream: rr.RecordingStream | None = None

    def start(self, episode: EpisodeStart) -> None:
        """Open the file and record the episode's constants, start and goal.

        Raises:
            SdfgcnError: The file cannot be written, the pictures are missing, or the
                environment variable RERUN switches recording off.
        """
        self._episode = episode
        self._objects = () if episode.truth is None else episode.truth.objects
        self._radii = np.zeros(episode.n_objects)
        for slot, model in enumerate(self._objects):
            self._radii[slot] = np.linalg.norm(model.vertices, axis=1).max()
        self._drawn_sdfs: dict[int, NDArray[np.float32]] = {}
        self._return = 0.0
        self._last: StepRecord | None = None
        self._stream = self._open()
        self._log_classes()
        self._log_table()
        self._log_camera()
        self._log_objects()
        self._log_goal()
        self._log_sdf_names()
        self._log_series_styles()
        self._at(0)
        self._log_scene(episode.start)
        self._log("log", rr.TextLog(f"Start of the episode with seed {episode.seed}."))

    def step(self, step: StepRecord) -> None:
        """Record one push, the scene after it and its reward."""
        if self._last is None:
            self._send_blueprint(with_q_values=step.q_values is not None)
        self._at(step.index)
        self._log_push(step)
        self._log_scene(step.after)
        self._log_figures(step)
        self._last = step

    def close(self) -> None:
        """Write the summary, finish the file and give it its final name."""
        if self._stream is None:
            return
        if self._last is None:
            self._send_blueprint(with_q_values=False)
        self._log_summary()
        self._stream.flush()
        self._stream.disconnect()
        self._stream = None
        self._partial.replace(self._path)

    def _open(self) -> rr.RecordingStream:
        stream = rr.RecordingStream(
            # The viewer shares one layout per application id, and the layout depends only on
            # the number of objects.
            f"sdfgcn {self._episode.n_objects} objects",
            batcher_config=_BATCHES,
        )
        if not rr.is_enabled(recording=stream):
            raise SdfgcnError(
                "The environment variable RERUN switches recording off; unset it or run viz=none."
            )
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            stream.save(self._partial)
        except (OSError, RuntimeError) as error:
            raise SdfgcnError(
                f"Cannot write the recording {self._path} ({error}); choose a writable run "
                "folder with hydra.run.dir=... or run viz=none."
            ) from error
        stream.set_log_time_enabled(False)  # wall-clock time says nothing about an episode
        stream.send_recording_name(f"{self._path.stem} (seed {self._episode.seed})")
        return stream

    def _log(self, path: str, *entity: rr.AsComponents, static: bool = False) -> None:
        assert self._stream is not None, "start() comes first"
        self._stream.log(path, *entity, static=static, strict=True)

    def _at(self, push: int) -> None:
        assert self._stream is not None, "start() comes first"
        self._stream.set_time(TIMELINE, sequence=push)

    def _name(self, slot: int) -> str:
        return slot_name(self._episode, slot)

    def _log_classes(self) -> None:
        slots = range(self._episode.n_objects)
        classes = [(slot + 1, self._name(slot), slot_color(slot)) for slot in slots]
        classes.append((self._unmatched, "unmatched", UNMATCHED_COLOR))
        self._log("/", rr.AnnotationContext([(0, "table", (0, 0, 0, 0)), *classes]), static=True)

    @property
    def _unmatched(self) -> int:
        return self._episode.n_objects + 1

    def _log_table(self) -> None:
        arena = self._env.arena
        self._log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._log("world/table", table(arena.reach_x, arena.reach_y), static=True)
        spawn = region(arena.spawn_x, arena.spawn_y, color=(200, 200, 200))
        self._log("world/bounds/spawn", spawn, static=True)
        allowed = region(arena.range_x, arena.range_y, color=(220, 60, 60))
        self._log("world/bounds/range", allowed, static=True)

    def _log_camera(self) -> None:
        camera = self._episode.camera
        pose = rr.Transform3D(translation=camera.position, mat3x3=camera.rotation)
        self._log("world/camera", pose, pinhole(camera), static=True)

    def _log_objects(self) -> None:
        truth = self._episode.truth
        if truth is None:
            return
        for slot, model in enumerate(truth.objects):
            color = np.round(255 * truth.colors[slot]).astype(np.uint8)
            self._log(f"world/objects/{slot}", mesh(model, color, skin=True), static=True)
            ghost = mesh(model, (*slot_color(slot), GOAL_ALPHA))
            pose = transform(truth.goal_poses[slot])
            self._log(f"world/goal/{slot}", ghost, pose, static=True)

    def _log_goal(self) -> None:
        goal = self._episode.goal
        slots = row_slots(goal, self._radii, self._episode.camera)
        self._log_picture("goal", goal, slots, static=True)
        strips, classes = [], []
        for row in np.flatnonzero(goal.scene.node_mask.numpy()):
            sdf, slot = goal.scene.sdf[row].numpy(), slots[row]
            contour = zero_contour(sdf)
            strips += contour
            classes += [self._class_id(slot)] * len(contour)
            if slot >= 0:
                self._log_sdf(f"sdf/goal/{slot}", sdf, slot, static=True)
        outlines = rr.LineStrips2D(
            strips, class_ids=classes, radii=0.25, show_labels=False, draw_order=20
        )
        self._log("world/camera/goal", outlines, static=True)

    def _log_scene(self, moment: Snapshot) -> None:
        """Log picture, masks, poses, and the SDFs that changed."""
        slots = row_slots(moment, self._radii, self._episode.camera)
        self._log_picture("world/camera", moment, slots)
        self._log("world/camera/graph", edges_2d(moment, self._episode.goal))
        for slot, pose in enumerate(moment.poses if moment.poses is not None else ()):
            self._log(f"world/objects/{slot}", transform(pose))
        sdf = moment.scene.sdf.numpy()
        seen = {int(slot): sdf[row].copy() for row, slot in enumerate(slots) if slot >= 0}
        for slot, sdf in seen.items():
            if not np.array_equal(sdf, self._drawn_sdfs.get(slot, np.empty(0))):
                self._log_sdf(f"sdf/scene/{slot}", sdf, slot)
        for slot in self._drawn_sdfs.keys() - seen.keys():
            self._log(f"sdf/scene/{slot}", rr.Clear(recursive=True))
        self._drawn_sdfs = seen
        self._slots = slots
        self._last_row = max(np.flatnonzero(moment.scene.node_mask.numpy()), default=-1)

    def _log_picture(
        self, path: str, moment: Snapshot, slots: NDArray[np.intp], static: bool = False
    ) -> None:
        if moment.pixels is None:
            raise SdfgcnError(
                "The scene has no picture to record (Snapshot.pixels is None); set env.record to "
                "True before the episode is reset."
            )
        labels = np.zeros(moment.pixels.shape[:2], dtype=np.uint8)
        masks = moment.scene.masks.numpy()
        for row in np.flatnonzero(moment.scene.node_mask.numpy()):
            labels[masks[row]] = self._class_id(slots[row])
        self._log(f"{path}/picture", png(moment.pixels), static=static)
        image = rr.SegmentationImage(labels, opacity=MASK_OPACITY, draw_order=10)
        self._log(f"{path}/masks", image, static=static)

    def _class_id(self, slot: int) -> int:
        return int(slot) + 1 if slot >= 0 else self._unmatched

    def _log_sdf(
        self, path: str, sdf: NDArray[np.float32], slot: int, static: bool = False
    ) -> None:
        contour = rr.LineStrips2D(
            zero_contour(sdf), class_ids=slot + 1, radii=0.5, show_labels=False
        )
        self._log(path, sdf_image(sdf), static=static)
        self._log(f"{path}/contour", contour, static=static)

    def _log_sdf_names(self) -> None:
        """Place names at the lower edge, clear of most objects."""
        edge = [0.5 * self._episode.camera.size, 0.84 * self._episode.camera.size]
        for slot in range(self._episode.n_objects):
            name = rr.Points2D([edge], labels=self._name(slot), colors=slot_color(slot), radii=0)
            for which in ("scene", "goal"):
                self._log(f"sdf/{which}/{slot}/name", name, static=True)

    def _log_push(self, step: StepRecord) -> None:
        result = step.push.result
        start, end = self._episode.camera.project(np.stack([result.start, result.end]))
        self._log("world/camera/push", arrow_2d(start, end, result.status))
        self._log("world/push", arrow_3d(result.start, result.end, result.status))
        level = rr.TextLogLevel.INFO if result.status == "done" else rr.TextLogLevel.WARN
        # Rows of the scene before the push, on which the choice was based.
        names = [
            row_name(self._episode, row, int(slot))
            for row, slot in enumerate(self._slots)
            if row <= self._last_row
        ]
        row = step.push.row
        text = push_sentence(names[row] if row < len(names) else f"row {row}", step)
        self._log("log", rr.TextLog(text, level=level, color=STATUS_COLORS[result.status]))
        if step.q_values is not None:
            self._log_q_values(step, names)

    def _log_q_values(self, step: StepRecord, names: list[str]) -> None:
        # Rows beyond the detected objects are padding.
        q_values = np.asarray(step.q_values, dtype=np.float32)[: len(names)]
        self._log("q_values", rr.Tensor(q_values, dim_names=("row", "direction")))
        if step.push.row < len(names):
            words = rr.TextDocument(q_table(names, step), media_type=rr.MediaType.MARKDOWN)
            self._log("q_values/table", words)

    def _log_figures(self, step: StepRecord) -> None:
        self._return += step.reward
        for slot, distance in enumerate(step.distances):
            if np.isfinite(distance):
                self._log(f"distance/{slot}", rr.Scalars(float(distance)))
        self._log("distance/threshold", rr.Scalars(self._env.success_threshold))
        self._log("reward/total", rr.Scalars(step.reward))
        for term, value in step.reward_terms.items():
            self._log(f"reward/terms/{term}", rr.Scalars(value))
        self._log("outcome/return", rr.Scalars(self._return))
        self._log("outcome/success", rr.Scalars(float(step.success)))
        self._log("outcome/out_of_range", rr.Scalars(float(step.out_of_range)))

    def _log_series_styles(self) -> None:
        for slot in range(self._episode.n_objects):
            style = rr.SeriesLines(names=self._name(slot), colors=slot_color(slot))
            self._log(f"distance/{slot}", style, static=True)
        threshold = rr.SeriesLines(names="threshold of success", colors=(128, 128, 128))
        self._log("distance/threshold", threshold, static=True)
        self._log("reward/total", rr.SeriesLines(names="reward", widths=3.0), static=True)

    def _log_summary(self) -> None:
        episode, last = self._episode, self._last
        ended, pushes = outcome(last), last.index if last else 0
        text = summary(episode, last, self._return)
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._log("summary", document, static=True)
        self._log("log", rr.TextLog(f"{ended} after {pushes} pushes".capitalize() + "."))
        assert self._stream is not None
        properties = rr.AnyValues(
            seed=episode.seed,
            objects=[model.name for model in self._objects],
            outcome=ended,
            pushes=pushes,
            undiscounted_return=self._return,
        )
        self._stream.send_property("episode", properties)

    def _send_blueprint(self, with_q_values: bool) -> None:
        assert self._stream is not None, "start() comes first"
        layout = blueprint(self._env.arena, self._episode.n_objects, with_q_values)
        self._stream.send_blueprint(layout)
