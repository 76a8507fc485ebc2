"""The frames of a film: an episode's start, its pushes, and its outcome."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sdfgcn.config import EnvConfig
from sdfgcn.envs.records import EpisodeStart, Snapshot, StepRecord
from sdfgcn.errors import SdfgcnError
from sdfgcn.sim.film import FilmScene, Look
from sdfgcn.task.camera import CameraModel
from sdfgcn.task.world import Motion
from sdfgcn.viz import video_drawing as drawing
from sdfgcn.viz.colors import STATUS_COLORS, object_colors
from sdfgcn.viz.shapes import row_slots
from sdfgcn.viz.video_config import VideoConfig
from sdfgcn.viz.video_drawing import DIM, WHITE, Words
from sdfgcn.viz.words import outcome, push_heading, row_name

SUCCESS = STATUS_COLORS["done"]
FAILURE = STATUS_COLORS["blocked"]

Placed = tuple[NDArray[np.float64], NDArray[np.float64]]  # joints [J] and poses [n, 7]


class Film:
    """Draws an episode frame by frame; every push takes the same number of frames.

    With true poses, the frames are renderings of `sdfgcn.sim.film`. Otherwise they are the
    camera's pictures, in which nothing moves during a push.
    """

    def __init__(
        self, env: EnvConfig, viz: VideoConfig, episode: EpisodeStart, title: str = ""
    ) -> None:
        """Prepare the film of an episode.

        Args:
            env: Its environment.
            viz: Size, pace and looks.
            episode: Its start; `opening` shows it.
            title: Shown in every frame.
        """
        self._env, self._viz, self._episode, self._title = env, viz, episode, title
        self._height = viz.height
        self._shot = shot = _shot(env, viz, episode)
        self._colors = object_colors(episode)
        self._now: Snapshot = episode.start
        self._posture = shot.home
        self._last: StepRecord | None = None
        self._limit = env.pushes_per_object * episode.n_objects
        truth = episode.truth
        radii = [] if truth is None else [model.vertices for model in truth.objects]
        self._radii = np.array([np.linalg.norm(v, axis=1).max() for v in radii])
        if truth is None:
            self._radii = np.zeros(episode.n_objects)

    def opening(self) -> Iterator[Image.Image]:
        """The start of the episode, held."""
        words = [Words(f"Start, {self._episode.n_objects} objects", WHITE, bold=True)]
        hint = [Words("goals outlined, mm to go below", DIM)]
        unknown = np.full(self._episode.n_objects, np.nan)
        yield from self._held(words, hint, self._distances(self._now.poses, unknown))

    def push(self, step: StepRecord) -> Iterator[Image.Image]:
        """A push: the robot's way there, then the push itself."""
        frame_of = self._captioned_push(step)
        motion, before = step.push.result.motion, self._now
        jumps = self._viz.jump_frames
        if motion is None or not motion.phases or before.poses is None:
            there: list[Placed] = [(self._posture, self._poses(before))] * jumps
            during: list[Placed] = [
                (self._posture, self._poses(step.after))
            ] * self._viz.push_frames
        else:
            robot, objects = in_view(motion), motion.objects
            there = [
                (self._posture + share * (robot[0] - self._posture), before.poses)
                for share in (np.arange(jumps) + 1) / (jumps + 1)
            ]
            moments = evenly(robot, objects, self._viz.push_frames)
            during = [(robot[i], objects[i]) for i in moments]
            during[-1] = (robot[-1], self._poses(step.after))
        for placed in there:
            yield frame_of(self._shot.picture(before, *placed), placed[1])
        for placed in during:
            yield frame_of(self._shot.picture(step.after, *placed), placed[1])
        self._posture = during[-1][0]
        self._now, self._last = step.after, step

    def ending(self) -> Iterator[Image.Image]:
        """The outcome, held."""
        last = self._last
        pushes = last.index if last else 0
        color = SUCCESS if last and last.success else FAILURE
        ended = outcome(last).capitalize()
        words = [Words(f"{ended} after {pushes} pushes", color, bold=True)]
        distances = last.distances if last else np.full(self._episode.n_objects, np.nan)
        self._posture = self._shot.home
        yield from self._held(words, [], distances)

    def close(self) -> None:
        """Free the scene."""
        self._shot.close()

    def _held(
        self, left: Sequence[Words], right: Sequence[Words], distances: NDArray[np.float64]
    ) -> Iterator[Image.Image]:
        poses = self._poses(self._now)
        picture = self._shot.picture(self._now, self._posture, poses)
        self._mark(picture, poses)
        frame = self._finished(picture, left, right, distances)
        yield from itertools.repeat(frame, max(1, round(self._viz.hold * self._viz.fps)))

    def _captioned_push(self, step: StepRecord):
        """A function that finishes a picture [H, W, 3] taken during a push, given the poses."""
        result, before = step.push.result, self._now
        slot = int(row_slots(before, self._radii, self._episode.camera)[step.push.row])
        name = row_name(self._episode, step.push.row, slot)
        status = result.status.replace("_", " ")
        color = STATUS_COLORS[result.status]
        number = [Words(f"{step.index}/{self._limit}  ", DIM)]
        left = [*number, Words(push_heading(name, step), WHITE, bold=True)]
        right = [Words(status, color, bold=True)]
        ahead = np.array([np.cos(step.push.angle), np.sin(step.push.angle), 0.0])
        tip = result.end
        if np.linalg.norm(result.end - result.start) < 1e-6:  # not executed: where it would go
            tip = result.start + self._env.push.length * ahead
        start, end = self._shot.project(np.stack([result.start, tip]))

        def finish(picture: Image.Image, poses: NDArray[np.float64]) -> Image.Image:
            self._mark(picture, poses)
            drawing.draw_arrow(picture, start, end, color, self._height)
            away = self._distances(before.poses if before.poses is None else poses, step.distances)
            return self._finished(picture, left, right, away)

        return finish

    def _distances(
        self, poses: NDArray[np.float64] | None, seen: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """[n] metres from the goals, from the true poses if they are known."""
        if poses is None or self._episode.truth is None:
            return seen
        offsets = poses[:, :2] - self._episode.truth.goal_poses[:, :2]
        return np.linalg.norm(offsets, axis=1)

    def _poses(self, moment: Snapshot) -> NDArray[np.float64]:
        return _poses(moment, self._episode.n_objects)

    def _mark(self, picture: Image.Image, poses: NDArray[np.float64]) -> None:
        """Draw the goals' outlines and the objects' numbers."""
        for slot, lines in enumerate(self._shot.outlines):
            drawing.draw_outlines(picture, lines, self._colors[slot], self._height)
        for slot, at in enumerate(self._shot.project(poses[:, :3])):
            drawing.draw_label(picture, at, str(slot), self._colors[slot], self._height)
        drawing.draw_title(picture, self._title, self._height)

    def _finished(
        self,
        picture: Image.Image,
        left: Sequence[Words],
        right: Sequence[Words],
        distances: NDArray[np.float64],
    ) -> Image.Image:
        away = self._distance_words(distances)
        room = round(0.95 * self._viz.width)
        lines = [(left, right), (drawing.fitting(away, room, self._height), [])]
        return drawing.with_captions(picture, self._height, lines)

    def _distance_words(self, distances: NDArray[np.float64]) -> list[Words]:
        """Each object's number in its colour, and how far it is from its goal."""
        words = [Words("mm: ", DIM)]
        for slot, distance in enumerate(distances):
            there = bool(distance <= self._env.success_threshold)
            told = f"{1000 * distance:.0f}" if np.isfinite(distance) else "-"
            words.append(Words(f" {slot} ", self._colors[slot], bold=True))
            words.append(Words(f"{told}{' ✓' if there else ''}  ", SUCCESS if there else WHITE))
        return words


def in_view(motion: Motion) -> NDArray[np.float64]:
    """[T, J] positions of the robot's drives; it stays where it was lifted while objects settle."""
    moving = np.array(motion.phases) != "settle"
    last = np.maximum.accumulate(np.where(moving, np.arange(len(moving)), 0))
    return motion.joints[last]


def evenly(robot: NDArray[np.float64], poses: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Which moments of a motion to show so that equally much happens between any two.

    Args:
        robot: [F, J] joint positions.
        poses: [F, n, 7] poses of objects.
        count: Moments to show.

    Returns:
        [count] indices in order; the last is F - 1. What happens is the robot's way and the
        objects', each relative to its whole.
    """
    happened = np.zeros(len(robot))
    for places in (robot[:, None], poses[..., :3]):
        ways = np.linalg.norm(np.diff(places, axis=0), axis=-1).max(axis=-1, initial=0.0)
        happened[1:] += np.cumsum(ways) / max(float(ways.sum()), 1e-9)
    wanted = happened[-1] * (np.arange(count) + 1) / count
    return np.minimum(np.searchsorted(happened, wanted), len(robot) - 1)


def film_camera(viz: VideoConfig, height: int) -> CameraModel:
    """The camera of a film, for a picture `height` pixels high (and as wide, in this model)."""
    azimuth, elevation = np.radians([viz.camera_azimuth, viz.camera_elevation])
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    backward = np.cos(elevation) * level + np.array([0.0, 0.0, np.sin(elevation)])
    right = np.array([-level[1], level[0], 0.0])
    return CameraModel(
        position=np.array(viz.camera_target) + viz.camera_distance * backward,
        rotation=np.stack([right, np.cross(backward, right), backward], axis=-1),
        fovy=float(np.radians(viz.camera_fovy)),
        size=height,
    )


class _Scene:
    """Pictures of the simulated scene, with the robot."""

    def __init__(self, env: EnvConfig, viz: VideoConfig, episode: EpisodeStart) -> None:
        assert episode.truth is not None
        height = drawing.picture_height(viz.height)
        self._camera = film_camera(viz, height)
        self._shift = np.array([0.5 * (viz.width - height), 0.0])
        look = Look(
            height=height,
            width=viz.width,
            samples=viz.samples,
            shadows=viz.shadows,
            table_rgba=viz.table_rgba,
            ghost_alpha=viz.ghost_alpha,
        )
        self._scene = FilmScene(env.robot, episode.truth, self._camera, look)
        self.home = self._scene.home
        self.outlines = drawing.outlines(self._scene.goal_masks())

    def picture(
        self, moment: Snapshot, robot: NDArray[np.float64], poses: NDArray[np.float64]
    ) -> Image.Image:
        self._scene.show(robot, poses)
        return Image.fromarray(self._scene.picture())

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """[..., 2] pixels of world points [..., 3]."""
        return self._camera.project(points) + self._shift

    def close(self) -> None:
        self._scene.close()


class _Photographs:
    """The camera's own pictures, enlarged, of a world that does not know the true poses."""

    home: NDArray[np.float64] = np.zeros(0)

    def __init__(self, viz: VideoConfig, episode: EpisodeStart) -> None:
        self._camera, self._size = episode.camera, (viz.width, drawing.picture_height(viz.height))
        self._scale = min(self._size) / episode.camera.size
        self._corner = 0.5 * (np.array(self._size) - self._scale * episode.camera.size)
        goal = episode.goal.scene
        masks = goal.masks.numpy()[: episode.n_objects]
        self.outlines = [
            [self._scale * (line - 1.0) + self._corner + 1.0 for line in lines]
            for lines in drawing.outlines(masks)
        ]

    def picture(
        self, moment: Snapshot, robot: NDArray[np.float64], poses: NDArray[np.float64]
    ) -> Image.Image:
        if moment.pixels is None:
            raise SdfgcnError(
                "The scene has no picture to film (Snapshot.pixels is None); set env.record to "
                "True before the episode is reset."
            )
        side = min(self._size)
        picture = Image.new("RGB", self._size)
        enlarged = Image.fromarray(moment.pixels).resize((side, side), Image.Resampling.BICUBIC)
        picture.paste(enlarged, tuple(self._corner.astype(int)))
        return picture

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """[..., 2] pixels of world points [..., 3]."""
        return self._scale * self._camera.project(points) + self._corner

    def close(self) -> None:
        pass


def _shot(env: EnvConfig, viz: VideoConfig, episode: EpisodeStart) -> _Scene | _Photographs:
    if episode.truth is None or episode.start.poses is None:
        return _Photographs(viz, episode)
    return _Scene(env, viz, episode)


def _poses(moment: Snapshot, n: int) -> NDArray[np.float64]:
    """[n, 7] the true poses; without them, the centres that were seen, NaN for the others."""
    if moment.poses is not None:
        return moment.poses
    poses = np.full((n, 7), np.nan)
    seen = np.flatnonzero(moment.scene.node_mask.numpy()[:n])
    poses[seen, :2], poses[seen, 2] = moment.scene.center.numpy()[seen], 0.0
    return poses
