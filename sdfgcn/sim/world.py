"""The simulated world: combines task, composer environment and renderer."""

from __future__ import annotations

import functools
import logging
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from dm_control import composer, mjcf
from numpy.typing import NDArray

from sdfgcn.config import EnvConfig
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.objects.model import ObjectModel
from sdfgcn.registry import WORLDS
from sdfgcn.sim.episode import EpisodeSpec, draw_episode
from sdfgcn.sim.renderer import Renderer
from sdfgcn.sim.robots.visible import VisibleRobot
from sdfgcn.sim.task import RearrangementTask
from sdfgcn.task.camera import CameraModel, camera_model
from sdfgcn.task.world import Motion, Phase, PushCommand, PushResult, RobotShape, Truth

MAX_REDRAWS = 20  # draws of a scene after one in which an object is hidden

log = logging.getLogger(__name__)


@WORLDS.register("mujoco")
class MujocoWorld:
    """A `sdfgcn.task.world.World` in MuJoCo.

    Attributes:
        camera: Model of the one camera.
        catalogue: The objects that episodes are drawn from.
        task: The composer task.
        physics: The compiled model and its state.
        renderer: Renders the world.
        truth: The current episode's objects, their colours and true goal poses.
        watching: See `sdfgcn.task.world.WatchedWorld`.
    """

    def __init__(self, config: EnvConfig, catalogue: Sequence[ObjectModel] | None = None) -> None:
        """Compile the world; without a catalogue, load the one named in the config.

        Raises:
            SdfgcnError: The catalogue cannot be loaded.
        """
        self._config = config
        if catalogue is None:
            catalogue = load_catalogue(config.objects, config.split)
        self.catalogue = tuple(catalogue)
        self.camera: CameraModel = camera_model(config.arena)
        self.task = RearrangementTask(config, self.catalogue)
        self._environment = composer.Environment(
            self.task, recompile_mjcf_every_episode=False, legacy_step=False
        )
        self._renderer: Renderer | None = None
        self.truth: Truth | None = None
        self.watching = False

    @functools.cached_property
    def _visible_robot(self) -> VisibleRobot | None:
        return VisibleRobot.find(self._config.robot)  # takes seconds and memory, so only if asked

    @property
    def physics(self) -> mjcf.Physics:
        """The compiled model and its state."""
        return self._environment.physics

    @property
    def renderer(self) -> Renderer:
        """Renders the world in its current state."""
        if self._renderer is None:
            self._renderer = Renderer(self.physics, self._config.arena.image_size)
        return self._renderer

    @property
    def n_objects(self) -> int:
        """Number of objects in the current episode."""
        return len(self.task.episode.objects)

    # ------------------------------------------------------------------ episodes

    def reset(self, seed: int, n_objects: int) -> None:
        """Begin the episode drawn from the seed.

        A scene in which an object is hidden from the start, behind another or outside the picture,
        is drawn anew, up to `MAX_REDRAWS` times; then the first one is taken as it is.

        Raises:
            SdfgcnError: The episode cannot be drawn, see `draw_episode`.
        """
        config = replace(self._config, n_objects=n_objects)
        for redraw in range(MAX_REDRAWS + 1):
            self.begin(draw_episode(seed, self.catalogue, config, redraw))
            hidden = self._hidden()
            if not hidden:
                return
            log.warning(
                "The scene of seed %d is drawn anew: no pixel shows %s.", seed, " and ".join(hidden)
            )
        log.warning("The scene of seed %d is taken as first drawn: others hide objects too.", seed)
        self.begin(draw_episode(seed, self.catalogue, config))

    def _hidden(self) -> list[str]:
        """Names of the objects that no pixel of the picture shows."""
        seen = self.look().true_masks().any(axis=(1, 2))
        return [self.catalogue[i].name for i in self.task.episode.objects[~seen]]

    def begin(self, episode: EpisodeSpec) -> None:
        """Begin a given episode with objects of the catalogue."""
        self.task.begin(episode)
        self._environment.reset()
        self.truth = Truth(
            objects=tuple(self.catalogue[i] for i in episode.objects),
            colors=episode.colors,
            goal_poses=episode.goal,
        )

    def save_state(self) -> dict[str, Any]:
        """The episode and its objects' poses, as JSON-compatible data."""
        episode = {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in asdict(self.task.episode).items()
        }
        return {"episode": episode, "poses": self.poses().tolist()}

    def restore_state(self, state: dict[str, Any]) -> None:
        """Restore a state saved by this or another world with the same config."""
        episode: dict[str, Any] = {
            key: np.array(value) if isinstance(value, list) else value
            for key, value in state["episode"].items()
        }
        self.begin(EpisodeSpec(**episode))
        self.task.set_poses(self.physics, np.array(state["poses"]))

    # ------------------------------------------------------------------ looking and pushing

    def look(self) -> MujocoView:
        """View the current table."""
        return MujocoView(self)

    def look_at_goal(self) -> MujocoView:
        """View the goal; it is rendered by temporarily moving the objects there."""
        return MujocoView(self, self.task.episode.goal)

    def execute(self, command: PushCommand) -> PushResult:
        """Push, and wait until everything is at rest."""
        if not self.watching:
            return self.task.execute(self.physics, command)
        phases: list[Phase] = []
        joints, objects = [self.task.robot.home], [self.poses()]

        def watch(phase: Phase) -> None:
            phases.append(phase)
            joints.append(self.task.robot.joints(self.physics))
            objects.append(self.poses())

        result = self.task.execute(self.physics, command, watch)
        moments = np.array(joints)[1:]
        motion = Motion(tuple(phases), moments, self._links(moments), np.array(objects)[1:])
        return replace(result, motion=motion)

    def robot_shape(self) -> RobotShape | None:
        """What the robot looks like; None if it has no visual geoms."""
        return None if self._visible_robot is None else self._visible_robot.shape

    def _links(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """[T, L, 7] poses of the robot's links at joint positions [T, drives]."""
        robot = self._visible_robot
        return np.zeros((len(joints), 0, 7)) if robot is None else robot.poses(joints)

    def foresee(self, command: PushCommand) -> NDArray[np.float64]:
        """[n, 7] the poses after a push, which is taken back."""
        with self.objects_at(self.poses()):
            self.task.execute(self.physics, command)
            return self.poses()

    def poses(self) -> NDArray[np.float64]:
        """[n, 7] the objects' true poses: xyz in metres, quaternion w, x, y, z."""
        return self.task.poses(self.physics)

    @contextmanager
    def objects_at(self, poses: NDArray[np.float64]) -> Iterator[None]:
        """Temporarily place the objects at [n, 7] poses."""
        before = self.poses()
        self.task.set_poses(self.physics, poses)
        try:
            yield
        finally:
            self.task.set_poses(self.physics, before)

    def close(self) -> None:
        """Free the model and the rendering context."""
        self._environment.close()


class MujocoView:
    """A lazily rendered view of a `MujocoWorld`; the RGB picture is cached."""

    def __init__(self, world: MujocoWorld, poses: NDArray[np.float64] | None = None) -> None:
        """View the objects in their current poses, or at the given [n, 7] poses."""
        self._world = world
        self._poses = poses
        self._pixels: NDArray[np.uint8] | None = None

    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] the RGB picture."""
        if self._pixels is None:
            with self._there():
                self._pixels = self._world.renderer.pixels()
        return self._pixels

    def true_masks(self) -> NDArray[np.bool_]:
        """[n, H, W] one mask per object, from the renderer's segmentation."""
        with self._there():
            geoms = self._world.renderer.geom_ids()
        slots = np.arange(self._world.n_objects)
        return self._world.task.slot_of_geom[geoms] == slots[:, None, None]

    def _there(self) -> AbstractContextManager[None]:
        return nullcontext() if self._poses is None else self._world.objects_at(self._poses)
