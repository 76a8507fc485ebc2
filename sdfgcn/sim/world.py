"""The simulated world: task, composer and renderer put together, once."""

from __future__ import annotations

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
from sdfgcn.sim.task import RearrangementTask
from sdfgcn.task.camera import CameraModel, camera_model
from sdfgcn.task.world import PushCommand, PushResult, Truth


@WORLDS.register("mujoco")
class MujocoWorld:
    """A `sdfgcn.task.world.World` in MuJoCo.

    Attributes:
        camera: Takes every picture.
        catalogue: The objects that episodes are drawn from.
        task: The composer task.
        physics: The compiled model and its state.
        renderer: Takes the pictures.
        truth: The running episode's objects, their colours and true goals.
    """

    def __init__(self, config: EnvConfig, catalogue: Sequence[ObjectModel] | None = None) -> None:
        """Compile the world, of the objects that the config names if no catalogue is given.

        Raises:
            SdfgcnError: The catalogue cannot be had.
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

    @property
    def physics(self) -> mjcf.Physics:
        """The compiled model and its state."""
        return self._environment.physics

    @property
    def renderer(self) -> Renderer:
        """Takes pictures of the world as it is."""
        if self._renderer is None:
            self._renderer = Renderer(self.physics, self._config.arena.image_size)
        return self._renderer

    @property
    def n_objects(self) -> int:
        """Objects of the running episode."""
        return len(self.task.episode.objects)

    # ------------------------------------------------------------------ episodes

    def reset(self, seed: int, n_objects: int) -> None:
        """Begin the episode that the seed stands for.

        Raises:
            SdfgcnError: Its scenario cannot be had with these objects, or nothing fitted.
        """
        config = replace(self._config, n_objects=n_objects)
        self.begin(draw_episode(seed, self.catalogue, config))

    def begin(self, episode: EpisodeSpec) -> None:
        """Begin any episode of objects of the catalogue."""
        self.task.begin(episode)
        self._environment.reset()
        self.truth = Truth(
            objects=tuple(self.catalogue[i] for i in episode.objects),
            colors=episode.colors,
            goal_poses=episode.goal,
        )

    def save_state(self) -> dict[str, Any]:
        """The episode and where its objects are, as JSON knows it."""
        episode = {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in asdict(self.task.episode).items()
        }
        return {"episode": episode, "poses": self.poses().tolist()}

    def restore_state(self, state: dict[str, Any]) -> None:
        """Go back to a saved state, also one of another world with the same config."""
        episode: dict[str, Any] = {
            key: np.array(value) if isinstance(value, list) else value
            for key, value in state["episode"].items()
        }
        self.begin(EpisodeSpec(**episode))
        self.task.set_poses(self.physics, np.array(state["poses"]))

    # ------------------------------------------------------------------ looking and pushing

    def look(self) -> MujocoView:
        """The table as it is."""
        return MujocoView(self)

    def look_at_goal(self) -> MujocoView:
        """The goal: its pictures are taken with the objects put there, and put back."""
        return MujocoView(self, self.task.episode.goal)

    def execute(self, command: PushCommand) -> PushResult:
        """Push, and wait until everything lies still."""
        return self.task.execute(self.physics, command)

    def poses(self) -> NDArray[np.float64]:
        """[n, 7] the objects' true poses: xyz in metres, quaternion w, x, y, z."""
        return self.task.poses(self.physics)

    @contextmanager
    def objects_at(self, poses: NDArray[np.float64]) -> Iterator[None]:
        """Put the objects at [n, 7] poses for a while, and back."""
        before = self.poses()
        self.task.set_poses(self.physics, poses)
        try:
            yield
        finally:
            self.task.set_poses(self.physics, before)

    def close(self) -> None:
        """Free the model and the picture's context."""
        self._environment.close()


class MujocoView:
    """One moment of a `MujocoWorld`; rendered when it is asked for, and only once."""

    def __init__(self, world: MujocoWorld, poses: NDArray[np.float64] | None = None) -> None:
        """Look at the objects as they are, or as they would be at [n, 7] poses."""
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
        """[n, H, W] one mask per object, by the renderer's segmentation."""
        with self._there():
            geoms = self._world.renderer.geom_ids()
        slots = np.arange(self._world.n_objects)
        return self._world.task.slot_of_geom[geoms] == slots[:, None, None]

    def _there(self) -> AbstractContextManager[None]:
        return nullcontext() if self._poses is None else self._world.objects_at(self._poses)
