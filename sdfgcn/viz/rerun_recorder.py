"""One episode as a rerun recording (`viz=rerun`); open it with `rerun FILE`.

Two timelines. "push" is for reading: at k, the scene before push k, what the agent thought of it,
the push, and what came of it; the last number is the scene at the end. "motion" is for watching: a
second for each push, from k seconds on, in which the robot moves; at k + 0.9 come the displacements
and at k + 1 the scene after it. It plays in the viewer like a film; choose it beside the buttons.

Entities, where i is an object's slot:

    world/robot/NAME                   the robot's links, at home, at the push, and in between
    world/objects/i, world/goal/i      meshes at their poses; the goal is translucent
    world/push                         the push as an arrow, coloured by its status
    world/expected, world/moved        displacements, as the agent expects them and as they came
    world/table, world/bounds/*        the regions on the table
    world/camera                       pinhole, with the following in its picture
    world/camera/picture, masks, names, goal
    world/camera/graph                 the scene graph's edges, between objects and to their goals
    world/camera/values                an arrow for every legal push: longer is better, in the
                                       colours of the heat map; the chosen one is white
    world/camera/push                  the push; one that was blocked as it was meant
    world/camera/expected/moves, ring  expected displacements, with their standard deviation
    world/camera/moved                 displacements as they came
    goal/picture, masks, names         the goal picture
    sdf/scene/i, sdf/goal/i            signed distances in colours, with the zero contour below
    distance/i, distance/threshold     metres to the goal, and the success threshold
    reward/total, reward/terms/*       the reward of each push
    outcome/return                     undiscounted return so far
    outcome/success, outcome/out_of_range
    q_values                           [rows, D] Q-values behind the push, if any
    q_values/heat_map, q_values/table  the same as a picture and as a table
    expected/scores                    the best pushes with the scores of an explanation, if any
    words, log, summary                what happened, in words

An object has one colour everywhere; see `object_colors`. Without true poses (a world without truth)
there are no meshes, names and colours go by row, and distances are between the detected centres.

Only the files `rerun_*.py` import rerun.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sdfgcn.config import EnvConfig
from sdfgcn.envs.records import EpisodeStart, Snapshot, StepRecord
from sdfgcn.errors import SdfgcnError
from sdfgcn.task.world import Motion
from sdfgcn.viz import Recorder
from sdfgcn.viz.colors import STATUS_COLORS
from sdfgcn.viz.rerun_decision import OF_A_PUSH, Decision, DecisionDrawing
from sdfgcn.viz.rerun_drawing import arrow_2d, arrow_3d, edges_2d, markdown, transform
from sdfgcn.viz.rerun_layout import MOTION, PUSHES, blueprint
from sdfgcn.viz.rerun_scene import SceneDrawing
from sdfgcn.viz.shapes import displacements, goal_distances, moments_to_draw, row_slots
from sdfgcn.viz.words import outcome, push_sentence, push_words, row_name, summary

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

        Regions, success threshold and the length of a push that was not made are those of `env`.
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
        self._return = 0.0
        self._last: StepRecord | None = None
        self._stream = self._open()
        self._scene = SceneDrawing(self._log, episode, self._env)
        self._decisions = DecisionDrawing(self._log, self._scene, self._env)
        self._scene.log_constants()
        self._at(1)
        self._log_now(episode.start)
        self._log_distances(goal_distances(episode.start, episode.goal))
        self._log_text(f"Start of the episode with seed {episode.seed}.")

    def step(self, step: StepRecord) -> None:
        """Record one push with the scene before it, and the scene after it."""
        if self._last is None:
            self._send_blueprint(step)
        decision = self._decision(step)
        self._at(step.index)
        self._log_push(decision)
        self._decisions.log(decision)
        self._log_outcome(step)
        self._log_motion(decision)
        self._at(step.index + 1)
        self._log_now(step.after)
        self._log_distances(step.distances)
        self._last = step

    def close(self) -> None:
        """Write what needs the whole episode, finish the file and give it its final name."""
        if self._stream is None:
            return
        if self._last is None:
            self._send_blueprint(None)
        else:
            self._decisions.log_values(self._at)
            self._at(self._last.index + 1)
            for path in OF_A_PUSH:
                self._log(path, rr.Clear(recursive=False))
            for timeline in (PUSHES, MOTION):
                self._log_robot_at_home(timeline, self._last.index + 1)
            self._at(self._last.index + 1)
        self._log_summary()
        self._stream.flush()
        self._stream.disconnect()
        self._stream = None
        self._partial.replace(self._path)

    # ------------------------------------------------------------------ the file

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
        """Log at a push on both timelines from now on."""
        self._at_only(PUSHES, push)
        assert self._stream is not None
        self._stream.set_time(MOTION, duration=float(push))

    def _at_only(self, timeline: str, time: float) -> None:
        """Log on one timeline from now on: at a push, or at seconds of motion."""
        assert self._stream is not None, "start() comes first"
        self._stream.reset_time()
        if timeline == PUSHES:
            self._stream.set_time(PUSHES, sequence=int(time))
        else:
            self._stream.set_time(MOTION, duration=time)

    def _send_blueprint(self, first: StepRecord | None) -> None:
        assert self._stream is not None, "start() comes first"
        layout = blueprint(
            self._env.arena,
            self._episode.n_objects,
            self._env.push.directions if first is None else first.legal.shape[1],
            with_values=first is not None and first.q_values is not None,
            with_scores=first is not None and first.explanation is not None,
        )
        self._stream.send_blueprint(layout)

    # ------------------------------------------------------------------ scenes and pushes

    def _log_now(self, moment: Snapshot) -> None:
        """Log what stands on the table."""
        self._now = moment
        self._slots = row_slots(moment, self._scene.radii, self._episode.camera)
        self._scene.log_moment(moment, self._slots)
        self._log("world/camera/graph", edges_2d(moment, self._episode.goal))

    def _decision(self, step: StepRecord) -> Decision:
        """The push with the rows on which its choice was based; rows beyond them are padding."""
        seen = np.flatnonzero(self._now.scene.node_mask.numpy())
        slots = self._slots[: int(max(seen, default=-1)) + 1]
        return Decision(
            step=step,
            before=self._now,
            slots=self._slots,
            names=[row_name(self._episode, row, int(slot)) for row, slot in enumerate(slots)],
            colors=[self._scene.color(int(slot)) for slot in slots],
        )

    def _log_push(self, decision: Decision) -> None:
        step, names = decision.step, decision.names
        result = step.push.result
        status, start, end = result.status, result.start, result.end
        if status in ("blocked", "unreachable"):  # drawn as it was meant
            ahead = np.array([np.cos(step.push.angle), np.sin(step.push.angle), 0.0])
            end = start + self._env.push.length * ahead
        if np.isfinite(start).all():
            tail, tip = self._episode.camera.project(np.stack([start, end]))
            self._log("world/camera/push", arrow_2d(tail, tip, status))
            self._log("world/push", arrow_3d(start, end, status))
        else:  # the row held no object
            self._log("world/camera/push", rr.Clear(recursive=False))
            self._log("world/push", rr.Clear(recursive=False))
        level = rr.TextLogLevel.INFO if status == "done" else rr.TextLogLevel.WARN
        row = step.push.row
        text = push_sentence(names[row] if row < len(names) else f"row {row}", step)
        self._log("log", rr.TextLog(text, level=level, color=STATUS_COLORS[status]))

    def _log_text(self, text: str) -> None:
        """Log a line with the components of those of pushes, so that all keep their order."""
        level, color = rr.TextLogLevel.INFO, (200, 200, 200)
        self._log("log", rr.TextLog(text, level=level, color=color))

    def _log_motion(self, decision: Decision) -> None:
        """Log the moments of the push and, last, how far the objects moved."""
        step = decision.step
        motion, k = step.push.result.motion, step.index
        moved = displacements(decision.before, step.after, decision.slots)
        before = goal_distances(decision.before, self._episode.goal)
        words = push_words(decision.names, step, moved, before)
        self._log("words", markdown(words))
        if motion is not None:
            self._log_robot(motion, k)
        for timeline, time in ((PUSHES, k), (MOTION, k + 0.9)):
            self._at_only(timeline, time)
            self._decisions.log_moved(decision, moved[: len(decision.names)])
        self._at_only(MOTION, k + 1.0)
        for path in ("world/moved", "world/camera/moved"):
            self._log(path, rr.Clear(recursive=False))

    def _log_robot(self, motion: Motion, k: int) -> None:
        """Log the robot in push k, and the objects that it moves.

        A pose is logged once at each time: of two at one time, the viewer may show either.
        """
        self._log_robot_at_home(MOTION, k)
        if len(motion.phases):
            begin = motion.phases.index("push") if "push" in motion.phases else -1
            self._at_only(PUSHES, k)
            self._log_links(motion.links[begin])
        else:
            self._log_robot_at_home(PUSHES, k)
        kept = moments_to_draw(motion)
        for place, moment in enumerate(kept, start=1):
            self._at_only(MOTION, k + 0.8 * place / len(kept))
            self._log_links(motion.links[moment])
            self._scene.log_poses(motion.objects[moment])

    def _log_robot_at_home(self, timeline: str, time: int) -> None:
        if self._episode.robot is not None:
            self._at_only(timeline, time)
            self._log_links(self._episode.robot.home)

    def _log_links(self, poses: NDArray[np.float64]) -> None:
        for part, pose in zip(self._scene.links, poses, strict=True):
            self._log(f"world/robot/{part.name}", transform(pose))

    # ------------------------------------------------------------------ figures and words

    def _log_outcome(self, step: StepRecord) -> None:
        self._return += step.reward
        self._log("reward/total", rr.Scalars(step.reward))
        for term, value in step.reward_terms.items():
            self._log(f"reward/terms/{term}", rr.Scalars(value))
        self._log("outcome/return", rr.Scalars(self._return))
        self._log("outcome/success", rr.Scalars(float(step.success)))
        self._log("outcome/out_of_range", rr.Scalars(float(step.out_of_range)))

    def _log_distances(self, distances: NDArray[np.float64]) -> None:
        for slot, distance in enumerate(distances):
            if np.isfinite(distance):
                self._log(f"distance/{slot}", rr.Scalars(float(distance)))
        self._log("distance/threshold", rr.Scalars(self._env.success_threshold))

    def _log_summary(self) -> None:
        episode, last = self._episode, self._last
        ended, pushes = outcome(last), last.index if last else 0
        self._log("summary", markdown(summary(episode, last, self._return)), static=True)
        end = f"{ended} after {pushes} pushes".capitalize() + "."
        self._log_text(end)
        self._log("words", markdown(f"### {end}"))
        assert self._stream is not None
        properties = rr.AnyValues(
            seed=episode.seed,
            objects=[model.name for model in self._scene.objects],
            outcome=ended,
            pushes=pushes,
            undiscounted_return=self._return,
        )
        self._stream.send_property("episode", properties)
