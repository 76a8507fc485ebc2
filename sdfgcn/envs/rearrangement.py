"""The rearrangement task as a TorchRL env."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase

from sdfgcn.config import EnvConfig
from sdfgcn.envs.records import EpisodeStart, Push, Snapshot, StepRecord
from sdfgcn.envs.reward import reward_terms
from sdfgcn.envs.standing import Standing, nearest_objects, seen_standing, true_standing
from sdfgcn.perception.base import detected
from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.registry import PERCEPTIONS, WORLDS
from sdfgcn.task.push_space import PushSpace
from sdfgcn.task.region import Region
from sdfgcn.task.scene import Detections, Scene
from sdfgcn.task.world import View, World


class RearrangementEnv(EnvBase):
    """Push objects into the goal arrangement (paper section IV).

    One step is one push. N is `max_objects`, D the number of push directions, H and W the
    picture's size. Row i of `scene` and row i of `goal` show the same object where they are
    matched, and an object keeps its row from push to push.

    Observation:
        `scene`, `goal`: a `Scene` each, from the current picture and from the goal's picture.
        `matched`: bool [N], the rows in which both show the same object.
        `action_mask`: bool [N * D], the legal actions; never all false.
        `pushes`: int64 [1], pushes so far in the episode.
        `n_objects`: int64 [1], objects in the episode.
        `success`, `out_of_range`: bool [1].
        `pixels`, `goal_pixels`: uint8 [H, W, 3], only with `config.pixels`.

    Action: one index, see `PushSpace`. An illegal action moves nothing but counts as a step.

    Without true poses (`World.poses`), reward, success and out of range are computed from detected
    centres, and `position` equals `center`.

    Attributes:
        config: The `env` part of the experiment's config.
        world: The objects, the camera and the robot.
        push_space: The actions, and where pushes start.
        n_objects: Objects in the next episode, 1 to `max_objects`; may be set.
        record: Whether `episode_start` and `last_step` include RGB pictures, and the pushes their
            motion; may be set.
        episode_start: The constants and first moment of the current episode.
        last_step: The last push; None at the start of an episode.
    """

    scene_type: type[Scene] = Scene  # a subclass may add fields

    def __init__(
        self, config: EnvConfig, seed: int | None = None, world: World | None = None
    ) -> None:
        """Build perception and world.

        Args:
            config: The `env` part of the experiment's config.
            seed: Seed from which episode seeds are drawn; None draws one from torch.
            world: The world to push in; None builds the one that the config names.

        Raises:
            SdfgcnError: The catalogue or the perception's weights are unavailable, or the config
                names an unknown perception or SDF method.
        """
        arena = config.arena
        self._sdf = SdfTransform(config.perception.sdf, arena.image_size)
        perception = PERCEPTIONS.find(config.perception.name)
        super().__init__(device=torch.device("cpu"), batch_size=[])
        self.config = config
        self.n_objects = config.n_objects
        self.push_space = PushSpace(config.push, arena)
        self._perception = perception(config.perception, config.max_objects)
        self.world: World = world or WORLDS.find(config.world.name)(config)
        self.is_closed = False  # TorchRL's base class sets True, as it has nothing to close
        self._allowed = Region.range(arena)
        self.record = False
        self._episode_seed: int | None = None
        self.episode_start: EpisodeStart
        self.last_step: StepRecord | None = None
        self._make_specs()
        self.set_seed(int(torch.randint(2**31, ())) if seed is None else seed)

    # ------------------------------------------------------------------ specs

    def _make_specs(self) -> None:
        n, size = self.config.max_objects, self.config.arena.image_size
        n_actions = n * self.push_space.n_directions
        observation: dict[str, Any] = {
            "scene": self.scene_type.spec(n, size),
            "goal": self.scene_type.spec(n, size),
            "matched": Binary(shape=(n,), dtype=torch.bool),
            "action_mask": Binary(shape=(n_actions,), dtype=torch.bool),
            "pushes": Unbounded((1,), dtype=torch.int64),
            "n_objects": Unbounded((1,), dtype=torch.int64),
            "success": Binary(shape=(1,), dtype=torch.bool),
            "out_of_range": Binary(shape=(1,), dtype=torch.bool),
        }
        if self.config.pixels:
            for key in ("pixels", "goal_pixels"):
                observation[key] = Unbounded((size, size, 3), dtype=torch.uint8)
        self.observation_spec = Composite(observation)
        self.action_spec = self.push_space.spec(n)
        self._action_leaf = self.action_spec  # a lookup takes a third of a millisecond
        self.reward_spec = Unbounded((1,), dtype=torch.float32)
        flags = ("done", "terminated", "truncated")
        self.done_spec = Composite({key: Binary(shape=(1,), dtype=torch.bool) for key in flags})

    # ------------------------------------------------------------------ TorchRL's hooks

    def _set_seed(self, seed: int | None) -> None:
        self._rng = np.random.default_rng(seed)

    def reset_episode(self, seed: int) -> TensorDictBase:
        """Reset to the episode that `seed` determines, whatever came before."""
        self._episode_seed = seed
        return self.reset()

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        seed = self._episode_seed
        if seed is None:
            seed = int(self._rng.integers(2**31))
        self._episode_seed = None
        self.world.reset(seed, self.n_objects)
        return self._begin(seed, pushes=0)

    def _begin(self, seed: int, pushes: int) -> TensorDictBase:
        """Start observing from the world's current state, with `pushes` pushes done."""
        self._seed_of_episode = seed
        goal = self.world.look_at_goal()
        self._goal = self._snapshot(self._perception.see_goal(goal), None, goal)
        self._pushes = pushes
        self._look()
        self._standing = self._stand()
        self.last_step = None
        self.episode_start = EpisodeStart(
            seed=seed,
            n_objects=self.world.n_objects,
            truth=self.world.truth,
            start=self._now,
            goal=self._goal,
            camera=self.world.camera,
        )
        return self._observation()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        row, direction = self.push_space.decode(int(tensordict["action"]))
        detected_before, legal = self._now.scene.node_mask, self._action_mask
        command = self.push_space.command(self._plan, detected_before.numpy(), row, direction)
        self.world.record = self.record
        result = self.world.execute(command)
        self._pushes += 1
        self._look()
        before, self._standing = self._standing, self._stand()
        detections = int(self._now.scene.node_mask.sum())
        terms = reward_terms(
            self.config.reward,
            before.distances,
            self._standing.distances,
            success=self._standing.success,
            out_of_range=self._standing.out_of_range,
            vanished=max(0, int(detected_before.sum()) - detections),
            none_left=detections == 0,
        )
        terminated = self._standing.success or self._standing.out_of_range or detections == 0
        limit = self.config.pushes_per_object * self.world.n_objects
        truncated = not terminated and self._pushes >= limit
        self.last_step = StepRecord(
            index=self._pushes,
            push=Push(row, direction, command.angle, result),
            after=self._now,
            distances=self._standing.distances,
            reward_terms=terms,
            reward=sum(terms.values()),
            success=self._standing.success,
            out_of_range=self._standing.out_of_range,
            terminated=terminated,
            truncated=truncated,
            legal=self.push_space.by_direction(legal).numpy(),
        )
        observation = self._observation()
        observation["reward"] = torch.tensor([self.last_step.reward], dtype=torch.float32)
        observation["terminated"] = torch.tensor([terminated])
        observation["truncated"] = torch.tensor([truncated])
        observation["done"] = torch.tensor([terminated or truncated])
        return observation

    # ------------------------------------------------------------------ saving and restoring

    def save_state(self) -> dict[str, Any]:
        """The state that the rest of the episode and later ones depend on, in JSON types.

        Raises:
            SdfgcnError: The world cannot be restored.
        """
        return {
            "world": self.world.save_state(),
            "seed": self._seed_of_episode,
            "pushes": self._pushes,
            "rng": self._rng.bit_generator.state,
        }

    def restore_state(self, state: dict[str, Any]) -> TensorDictBase:
        """Restore a saved state, which may come from another env with the same config.

        Returns:
            The observation in that state.
        """
        self.world.restore_state(state["world"])
        self._rng.bit_generator.state = state["rng"]
        return self._begin(state["seed"], state["pushes"])

    # ------------------------------------------------------------------ looking

    def _look(self) -> None:
        """Take a picture; update the snapshot, the push plan and the action mask."""
        view = self.world.look()
        masks, matched = self._perception.see(view)
        self._now = self._snapshot(masks, matched, view)
        rows = self._now.scene.node_mask.numpy()
        self._action_mask = self.push_space.action_mask(self._plan, rows, len(rows))
        self._action_leaf.update_mask(self._action_mask)

    def _snapshot(
        self, masks: NDArray[np.bool_], matched: NDArray[np.bool_] | None, view: View
    ) -> Snapshot:
        """The snapshot of masks [k, H, W]; `matched` [k] is None for the goal."""
        n, size = self.config.max_objects, self.config.arena.image_size
        found = detected(masks, self.config.perception.min_pixels)
        masks = masks[found]
        sdf = self._sdf.fields(masks)
        if matched is None:
            center, poses = self.push_space.centers(masks), self._goal_poses()
        else:
            self._plan = self.push_space.plan(masks, sdf)
            center, poses = self._plan.center, self.world.poses()
        position = self._true_positions(center, poses, found)
        scene = self.scene_type.of(Detections(masks, sdf, center, position), found, n, size)
        rows = scene.node_mask.numpy().copy()
        if matched is not None:
            # A mask too small to be a detection has no match, on either side.
            rows[: len(matched)] &= matched
            rows &= self._goal.scene.node_mask.numpy()
        pixels = view.pixels() if self.record or self.config.pixels else None
        return Snapshot(scene, rows, pixels, poses)

    def _goal_poses(self) -> NDArray[np.float64] | None:
        return None if self.world.truth is None else self.world.truth.goal_poses

    def _true_positions(
        self,
        center: NDArray[np.float64],
        poses: NDArray[np.float64] | None,
        found: NDArray[np.bool_],
    ) -> NDArray[np.float64]:
        """[m, 2] true centres of the m detections, metres; detected ones without truth."""
        if poses is None:
            return center
        if self._perception.rows_are_slots:
            return poses[found, :2]
        return nearest_objects(center, poses[:, :2])

    def _stand(self) -> Standing:
        threshold, poses, truth = self.config.success_threshold, self._now.poses, self.world.truth
        if poses is None or truth is None:
            scene, goal, matched = self._now.scene, self._goal.scene, self._now.matched
            return seen_standing(scene, goal, matched, threshold, self._allowed)
        return true_standing(poses, truth.goal_poses, threshold, self._allowed)

    def _observation(self) -> TensorDict:
        values: dict[str, Any] = {
            "scene": self._now.scene,
            "goal": self._goal.scene,
            "matched": torch.from_numpy(self._now.matched),
            "action_mask": self._action_mask,
            "pushes": torch.tensor([self._pushes]),
            "n_objects": torch.tensor([self.world.n_objects]),
            "success": torch.tensor([self._standing.success]),
            "out_of_range": torch.tensor([self._standing.out_of_range]),
        }
        if self.config.pixels:
            values["pixels"] = torch.from_numpy(self._now.pixels)
            values["goal_pixels"] = torch.from_numpy(self._goal.pixels)
        return TensorDict(values, batch_size=[])

    def close(self, *, raise_if_closed: bool = True) -> None:
        """Release the world's resources."""
        if not self.is_closed:
            self.world.close()
        super().close(raise_if_closed=raise_if_closed)
