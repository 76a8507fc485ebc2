"""The rearrangement task as a TorchRL environment."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from dm_control import composer
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from sdfgcn.config import N_DIRECTIONS, EnvConfig, lookup
from sdfgcn.envs.observation import View, by_row, nearest_objects, padded
from sdfgcn.envs.types import EpisodeStart, Scene, StepRecord
from sdfgcn.geometry.camera import camera_model
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.perception.perception import detected
from sdfgcn.perception.push_start import PushPlanner
from sdfgcn.perception.sdf import SDF_METHODS, signed_distances
from sdfgcn.registry import PERCEPTIONS
from sdfgcn.sim.episode import Episode, draw_episode
from sdfgcn.sim.renderer import Renderer
from sdfgcn.sim.task import RearrangementTask
from sdfgcn.sim.types import Push, PushCommand


class RearrangementEnv(EnvBase):
    """Push objects into the goal arrangement (paper section IV).

    One step is one push. N is `max_objects`, H and W the picture's size. Each row is a node: a
    place for one detected object, the same from push to push. Rows without one are zero.

    Observation:
        `sdf`, `goal_sdf`: float32 [N, H, W], pixels, negative inside.
        `node_mask`, `goal_node_mask`: bool [N], which rows hold a detected object.
        `correspondence`: int64 [N], for each row the goal's row it is matched with, -1 for none.
        `center`, `goal_center`: float32 [N, 2], detected centres on the table, metres.
        `position`, `goal_position`: float32 [N, 2], true centres of what the rows show, metres.
        `action_mask`: bool [N * 8], which actions are legal; never all false.
        `pushes`: int64 [1], pushes so far in the episode.
        `success`, `out_of_range`: bool [1].
        `pixels`, `goal_pixels`: uint8 [H, W, 3], only with `config.pixels`.

    Action: one index, `object * 8 + direction`; direction k heads 45 k degrees counter-clockwise
    from the table's x axis. An illegal action moves nothing and costs a step.
    """

    def __init__(self, config: EnvConfig, seed: int | None = None):
        """Load the catalogue and build the world.

        Args:
            config: The `env` part of the experiment's config.
            seed: Seed of the episodes' seeds; drawn by torch if None.

        Raises:
            SdfgcnError: The catalogue or the perception's weights cannot be had, or the config
                names no such perception or SDF method.
        """
        lookup(SDF_METHODS, "env.perception.sdf", config.perception.sdf)
        perception = lookup(PERCEPTIONS, "env.perception.name", config.perception.name)
        super().__init__(device=torch.device("cpu"), batch_size=[])
        self.config = config
        self.n_objects = config.n_objects  # of the next episode; may be set, 1 to max_objects
        self._perception = perception(config.perception, config.max_objects)
        self.catalogue = load_catalogue(config.objects, config.split)
        self.camera = camera_model(config.arena)
        self._planner = PushPlanner(self.camera, config.push, config.arena)
        self.record = False  # whether episode_start and last_step hold RGB pictures
        self._task = RearrangementTask(config, self.catalogue)
        self._environment = composer.Environment(
            self._task, recompile_mjcf_every_episode=False, legacy_step=False
        )
        self._renderer: Renderer | None = None
        self._episode_seed: int | None = None
        self.episode_start: EpisodeStart
        self.last_step: StepRecord | None = None
        self._make_specs()
        self.set_seed(int(torch.randint(2**31, ())) if seed is None else seed)

    # ------------------------------------------------------------------ specs

    def _make_specs(self) -> None:
        n, size = self.config.max_objects, self.config.arena.image_size
        observation: dict[str, Any] = {
            "sdf": Unbounded((n, size, size), dtype=torch.float32),
            "goal_sdf": Unbounded((n, size, size), dtype=torch.float32),
            "node_mask": Binary(shape=(n,), dtype=torch.bool),
            "goal_node_mask": Binary(shape=(n,), dtype=torch.bool),
            "correspondence": Bounded(-1, n - 1, (n,), dtype=torch.int64),
            "center": Unbounded((n, 2), dtype=torch.float32),
            "goal_center": Unbounded((n, 2), dtype=torch.float32),
            "position": Unbounded((n, 2), dtype=torch.float32),
            "goal_position": Unbounded((n, 2), dtype=torch.float32),
            "action_mask": Binary(shape=(n * N_DIRECTIONS,), dtype=torch.bool),
            "pushes": Unbounded((1,), dtype=torch.int64),
            "success": Binary(shape=(1,), dtype=torch.bool),
            "out_of_range": Binary(shape=(1,), dtype=torch.bool),
        }
        if self.config.pixels:
            for key in ("pixels", "goal_pixels"):
                observation[key] = Unbounded((size, size, 3), dtype=torch.uint8)
        self.observation_spec = Composite(observation)
        self.action_spec = Categorical(n * N_DIRECTIONS, shape=(), dtype=torch.int64)
        self._action_leaf = self.action_spec  # to look it up takes a third of a millisecond
        self.reward_spec = Unbounded((1,), dtype=torch.float32)
        flags = ("done", "terminated", "truncated")
        self.done_spec = Composite({key: Binary(shape=(1,), dtype=torch.bool) for key in flags})

    # ------------------------------------------------------------------ TorchRL's hooks

    def _set_seed(self, seed: int | None) -> None:
        self._rng = np.random.default_rng(seed)

    def reset_episode(self, seed: int) -> TensorDictBase:
        """Reset to the episode that `seed` stands for, whatever came before."""
        self._episode_seed = seed
        return self.reset()

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        seed = self._episode_seed
        if seed is None:
            seed = int(self._rng.integers(2**31))
        self._episode_seed = None
        config = replace(self.config, n_objects=self.n_objects)
        self._begin(draw_episode(seed, self.catalogue, config))
        return self._observation()

    def _begin(self, episode: Episode) -> None:
        """Take the goal's picture, then put everything at the start."""
        self._task.begin(episode)
        self._environment.reset()
        physics = self._environment.physics
        if self._renderer is None:
            self._renderer = Renderer(physics, self.config.arena.image_size)
        settled = self._task.poses(physics)
        self._task.set_poses(physics, episode.goal)
        self._goal_observation = self._look_at_goal()
        self._task.set_poses(physics, settled)
        self._look()
        self._pushes = 0
        self._update_mask()
        self.last_step = None
        self.episode_start = EpisodeStart(
            seed=episode.seed,
            objects=tuple(self.catalogue[i] for i in episode.objects),
            colors=episode.colors,
            scene=self._scene,
            goal=self._goal,
            camera=self.camera,
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = int(tensordict["action"])
        task = self._task
        found_before, legal = self._found, self._action_mask
        push = self._execute(*divmod(action, N_DIRECTIONS))
        self._pushes += 1
        self._look()
        vanished = max(0, int(found_before.sum()) - int(self._found.sum()))
        none_left = not self._found.any()
        terms = task.reward_terms(vanished=vanished, none_left=none_left)
        success, out_of_range = task.success, task.out_of_range
        terminated = success or out_of_range or none_left
        limit = self.config.pushes_per_object * len(task.episode.objects)
        truncated = not terminated and self._pushes >= limit
        self._update_mask()
        self.last_step = StepRecord(
            index=self._pushes,
            push=push,
            scene=self._scene,
            distances=task.distances,
            reward_terms=terms,
            reward=sum(terms.values()),
            success=success,
            out_of_range=out_of_range,
            terminated=terminated,
            truncated=truncated,
            q_values=None,
            legal=legal.reshape(-1, N_DIRECTIONS).numpy(),
        )
        result = self._observation(success=success, out_of_range=out_of_range)
        result["reward"] = torch.tensor([self.last_step.reward], dtype=torch.float32)
        result["terminated"] = torch.tensor([terminated])
        result["truncated"] = torch.tensor([truncated])
        result["done"] = torch.tensor([terminated or truncated])
        return result

    # ------------------------------------------------------------------ saving and restoring

    def save_state(self) -> dict[str, Any]:
        """All that the rest of the episode, and later ones, depend on; plain values and arrays."""
        return {
            "episode": self._task.episode,
            "poses": self._task.poses(self._environment.physics),
            "pushes": self._pushes,
            "rng": self._rng.bit_generator.state,
        }

    def restore_state(self, state: dict[str, Any]) -> TensorDictBase:
        """Go back to a saved state, also one of another environment with the same config.

        Returns:
            The observation there.
        """
        self._begin(state["episode"])
        self._task.resume(self._environment.physics, state["poses"])
        self._look()
        self._pushes = state["pushes"]
        self._rng.bit_generator.state = state["rng"]
        self._update_mask()
        return self._observation(success=self._task.success, out_of_range=self._task.out_of_range)

    # ------------------------------------------------------------------ looking and pushing

    def _look_at_goal(self) -> dict[str, torch.Tensor]:
        """Take the goal's picture. Returns its part of the observation, the episode through."""
        assert self._renderer is not None, "the first reset makes it"
        view = View(self._renderer, self._task)
        self._goal, found = self._scene_of(self._perception.see_goal(view), view)
        center = self._planner.centers(self._goal.masks[found])
        position = self._true_positions(center, self._task.episode.goal, found)
        n = self.config.max_objects
        values = {
            "goal_sdf": padded(self._goal.sdf, n),
            "goal_node_mask": padded(found, n),
            "goal_center": padded(by_row(center, found), n),
            "goal_position": padded(by_row(position, found), n),
        }
        if self._goal.pixels is not None and self.config.pixels:
            values["goal_pixels"] = torch.from_numpy(self._goal.pixels)
        return values

    def _look(self) -> None:
        """Take a picture: the scene, which rows show an object, and the pushes it offers."""
        assert self._renderer is not None, "the first reset makes it"
        view = View(self._renderer, self._task)
        masks, correspondence = self._perception.see(view)
        scene, self._found = self._scene_of(masks, view)
        # A mask that is too small to count is matched with nothing, and nothing is with it.
        goal_found = self._goal_observation["goal_node_mask"].numpy()
        matched = self._found & (correspondence >= 0) & goal_found[correspondence]
        self._scene = replace(scene, correspondence=np.where(matched, correspondence, -1))
        self._plan = self._planner.plan(scene.masks[self._found], scene.sdf[self._found])

    def _scene_of(self, masks: NDArray[np.bool_], view: View) -> tuple[Scene, NDArray[np.bool_]]:
        """The scene that [m, H, W] masks make, and which rows are large enough to count."""
        found = detected(masks, self.config.perception.min_pixels)
        masks = masks & found[:, None, None]
        sdf = signed_distances(masks, self.config.perception.sdf)
        sdf[~found] = 0.0
        scene = Scene(
            pixels=view.pixels() if self.record or self.config.pixels else None,
            masks=masks,
            sdf=sdf,
            poses=self._task.poses(self._environment.physics),
        )
        return scene, found

    def _execute(self, row: int, direction: int) -> Push:
        """Push the object in `row`; where there is no such push, nothing moves."""
        command = PushCommand(start=np.full(2, np.nan), direction=direction, free=0.0)
        if row < len(self._found) and self._found[row]:
            command = self._plan.command(int(self._found[:row].sum()), direction)
        # Not environment.step(): its own step after the push would be taken back again.
        physics, random_state = self._environment.physics, self._environment.random_state
        action = np.array([*command.start, command.direction, command.free])
        self._task.before_step(physics, action, random_state)
        self._task.after_step(physics, random_state)
        return replace(self._task.last_push, object=row)

    def _observation(self, success: bool = False, out_of_range: bool = False) -> TensorDict:
        n, found, scene = self.config.max_objects, self._found, self._scene
        assert scene.correspondence is not None, "only the goal has none"
        position = self._true_positions(self._plan.center, scene.poses, found)
        values: dict[str, Any] = {
            "sdf": padded(scene.sdf, n),
            "node_mask": padded(found, n),
            "correspondence": padded(scene.correspondence, n, fill=-1),
            "center": padded(by_row(self._plan.center, found), n),
            "position": padded(by_row(position, found), n),
            "action_mask": self._action_mask,
            "pushes": torch.tensor([self._pushes]),
            "success": torch.tensor([success]),
            "out_of_range": torch.tensor([out_of_range]),
            **self._goal_observation,
        }
        if self.config.pixels:
            values["pixels"] = torch.from_numpy(scene.pixels)
        return TensorDict(values, batch_size=[])

    def _true_positions(
        self, center: NDArray[np.float64], poses: NDArray[np.float64], found: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """[m, 2] the true centres of what the m detections show, metres."""
        if self._perception.rows_are_slots:
            return poses[found, :2]
        return nearest_objects(center, poses[:, :2])

    def _update_mask(self) -> None:
        """Work out which actions are legal, for the observation and for the action spec."""
        mask = np.zeros((self.config.max_objects, N_DIRECTIONS), dtype=bool)
        rows = np.flatnonzero(self._found)
        mask[rows] = self._plan.legal
        # Samplers and losses need one legal action everywhere, also in a terminal state: boxed-in
        # objects may be tried in vain, and where nothing is detected row 0 stands in.
        if not mask.any():
            mask[rows if len(rows) else 0] = True
        self._action_mask = torch.from_numpy(mask.ravel())
        self._action_leaf.update_mask(self._action_mask)

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Free the model and the picture's context."""
        if not self.is_closed:
            self._environment.close()
        super().close(raise_if_closed=raise_if_closed)
