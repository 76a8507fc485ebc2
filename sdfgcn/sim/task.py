"""The rearrangement task: props on the table, a goal, one push per control step."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from dm_control import composer, mjcf
from dm_env import specs
from mujoco import mjtSleepPolicy
from numpy.typing import NDArray

from sdfgcn.config import N_DIRECTIONS, EnvConfig
from sdfgcn.geometry.region import Region
from sdfgcn.objects.model import ObjectModel
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.arena import GROUP_PARKED, GROUP_SCENE, Table
from sdfgcn.sim.episode import Episode
from sdfgcn.sim.props import CONAFFINITY_PROP, CONTYPE_PROP, PARKING, Prop
from sdfgcn.sim.push import PushPrimitive
from sdfgcn.sim.reward import reward_terms
from sdfgcn.sim.types import Push, PushCommand

READY_TO_SLEEP = -1  # to which MuJoCo counts tree_asleep up while a tree lies still
SETTLE_STEPS = 5  # simulation steps between two looks at whether the props are at rest


class RearrangementTask(composer.Task):
    """Push the props of an episode to their goals (paper section IV).

    The action of one control step is a planned push: start x and y in metres, direction 0..7,
    free distance in metres. `begin` hands over the episode before each reset.
    """

    def __init__(self, config: EnvConfig, catalogue: Sequence[ObjectModel]):
        """Build the world: table, robot and every prop of the catalogue."""
        self._config = config
        self._table = Table(arena=config.arena, physics=config.physics)
        self.robot = ROBOTS[config.robot.name](config=config.robot)
        self._table.attach(self.robot)
        self._props = [Prop(model=model, physics=config.physics) for model in catalogue]
        for i, prop in enumerate(self._props):
            # Parked from the start: props piled up at the origin would all be in contact.
            self._table.add_free_entity(prop).pos = PARKING + np.array([0.5 * i, 0.0, 0.0])
        self._primitive = PushPrimitive(config.push, config.arena, self.robot)
        self._range = Region.range(config.arena)
        self.control_timestep = config.physics.timestep
        self._episode: Episode | None = None
        self._left = np.zeros((0, 7))
        self._previous = self._distances = np.zeros(0)
        self._last_push: Push | None = None

    @property
    def root_entity(self) -> composer.Entity:
        """The table."""
        return self._table

    def after_compile(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Look up where each prop lives in the compiled model."""
        del random_state
        joints = [mjcf.get_frame_freejoint(prop.mjcf_model) for prop in self._props]
        bodies = [mjcf.get_attachment_frame(prop.mjcf_model) for prop in self._props]
        qpos, qvel = physics.bind(joints).qposadr, physics.bind(joints).dofadr
        # A free joint has 7 positions and 6 velocities; the binding lists all of them.
        self._qpos = np.reshape(qpos, (len(joints), -1))[:, :1] + np.arange(7)
        self._qvel = np.reshape(qvel, (len(joints), -1))[:, :1] + np.arange(6)
        torques = np.array([prop.rolling_torque for prop in self._props])
        physics.model.dof_frictionloss[self._qvel[:, 3:]] = torques[:, None]
        self._bodies = physics.bind(bodies).element_id
        self._trees = physics.model.body_treeid[self._bodies]
        self._visuals = physics.bind([prop.visual for prop in self._props]).element_id
        self._pieces = physics.bind([g for prop in self._props for g in prop.pieces]).element_id
        self._piece_props = np.repeat(
            np.arange(len(self._props)), [len(prop.pieces) for prop in self._props]
        )
        self.slot_of_geom = np.full(physics.model.ngeom + 1, -1)

    def begin(self, episode: Episode) -> None:
        """Set the episode that the next reset starts."""
        self._episode = episode

    @property
    def episode(self) -> Episode:
        """The running episode."""
        if self._episode is None:
            raise RuntimeError("begin() was not called before the first reset")
        return self._episode

    @property
    def last_push(self) -> Push:
        """The last push; which object was meant is the caller's to know, so `object` is -1."""
        if self._last_push is None:
            raise RuntimeError("there was no push in this episode yet")
        return self._last_push

    # ------------------------------------------------------------------ composer's hooks

    def initialize_episode(
        self, physics: mjcf.Physics, random_state: np.random.RandomState
    ) -> None:
        """Park what is not in the episode, place the rest at the start and let it settle."""
        del random_state
        self._dress(physics)
        self.set_poses(physics, self.episode.start, resting=False)
        self._settle(physics)
        self.resume(physics, self.poses(physics))

    def _dress(self, physics: mjcf.Physics) -> None:
        """Show and colour the episode's props; park the others.

        A parked prop is hidden, touches nothing and sleeps from the start, so that it costs
        next to nothing however large the catalogue is.
        """
        model, chosen = physics.model, self.episode.objects
        active = np.zeros(len(self._props), dtype=bool)
        active[chosen] = True
        model.geom_group[self._visuals] = np.where(active, GROUP_SCENE, GROUP_PARKED)
        colors = self.episode.colors.copy()
        colors[[self._props[i].model.texture is not None for i in chosen]] = 1.0  # no tint
        model.geom_rgba[self._visuals[chosen]] = colors
        touching = active[self._piece_props]
        model.geom_contype[self._pieces] = touching * CONTYPE_PROP
        model.geom_conaffinity[self._pieces] = touching * CONAFFINITY_PROP
        model.body_contype[self._bodies] = active * CONTYPE_PROP
        model.body_conaffinity[self._bodies] = active * CONAFFINITY_PROP
        model.tree_sleep_policy[self._trees] = np.where(
            active, int(mjtSleepPolicy.mjSLEEP_ALLOWED), int(mjtSleepPolicy.mjSLEEP_INIT)
        )
        self.slot_of_geom[:] = -1
        self.slot_of_geom[self._visuals[chosen]] = np.arange(len(chosen))

    def action_spec(self, physics: mjcf.Physics) -> specs.BoundedArray:
        """[4]: start x, start y (metres), direction (0..7), free distance (metres)."""
        del physics
        arena = self._config.arena
        return specs.BoundedArray(
            shape=(4,),
            dtype=np.float64,
            minimum=[arena.reach_x[0], arena.reach_y[0], 0, 0.0],
            maximum=[arena.reach_x[1], arena.reach_y[1], N_DIRECTIONS - 1, 1.0],
            name="push",
        )

    def before_step(
        self, physics: mjcf.Physics, action: NDArray, random_state: np.random.RandomState
    ) -> None:
        """Execute the push and let the props come to rest."""
        del random_state
        command = PushCommand(start=action[:2], direction=int(action[2]), free=float(action[3]))
        options = physics.model.opt
        options.noslip_iterations = 0  # not while the tool moves: see conf/env/rearrangement.yaml
        status, start, end = self._primitive.execute(physics, command)
        options.noslip_iterations = self._config.physics.noslip_iterations
        if status != "unreachable":
            self._settle(physics)
        self._left = self.poses(physics)
        self._last_push = Push(
            object=-1, direction=command.direction, start=start, end=end, status=status
        )

    def after_step(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Leave the simulation in a state that follows from the props' poses alone.

        Velocities, warm starts and sleep are cleared, so that the next push depends on nothing
        that a saved pose does not hold. Composer's own step after the push is taken back: a
        push that is given up moves nothing.
        """
        del random_state
        self.set_poses(physics, self._left)
        self._previous, self._distances = self._distances, self._to_goal(self._left)

    def get_reward(self, physics: mjcf.Physics) -> float:
        """The sum of the reward's terms, as far as the simulation can tell."""
        del physics
        return sum(self.reward_terms().values())

    # ------------------------------------------------------------------ what is true

    def reward_terms(self, vanished: int = 0, none_left: bool = False) -> dict[str, float]:
        """The last push's reward terms; see `sdfgcn.sim.reward`."""
        return reward_terms(
            self._config.reward,
            self._previous,
            self._distances,
            success=self.success,
            out_of_range=self.out_of_range,
            vanished=vanished,
            none_left=none_left,
        )

    def poses(self, physics: mjcf.Physics) -> NDArray[np.float64]:
        """[n, 7] true poses in slot order: xyz in metres, quaternion w, x, y, z."""
        return physics.data.qpos[self._qpos[self.episode.objects]].copy()

    @property
    def distances(self) -> NDArray[np.float64]:
        """[n] horizontal distance of each object's centre to its goal after the push, metres."""
        return self._distances

    @property
    def success(self) -> bool:
        """Whether every object is within the threshold of its goal at the same moment."""
        return bool((self._distances <= self._config.success_threshold).all())

    @property
    def out_of_range(self) -> bool:
        """Whether some object's centre has left the allowed region."""
        return not self._range.contains(self._left[:, :2]).all()

    def _to_goal(self, poses: NDArray) -> NDArray[np.float64]:
        return np.linalg.norm(poses[:, :2] - self.episode.goal[:, :2], axis=1)

    # ------------------------------------------------------------------ placing and settling

    def set_poses(self, physics: mjcf.Physics, poses: NDArray, resting: bool = True) -> None:
        """Put the episode's objects at [n, 7] poses, without velocity, the robot at home.

        Args:
            physics: Changed in place.
            poses: xyz in metres, quaternion w, x, y, z.
            resting: Whether the objects are known to lie still there. Then they fall asleep at
                the first step that finds them so, and not after MuJoCo's ten.
        """
        # Not physics.reset(): that runs the whole forward pass once more.
        mujoco.mj_resetData(physics.model.ptr, physics.data.ptr)
        physics.data.qpos[self._qpos[self.episode.objects]] = poses
        if resting:
            physics.data.tree_asleep[self._trees[self.episode.objects]] = READY_TO_SLEEP
        self.robot.place(physics, self.robot.home)
        # As much of the forward pass as a picture needs; the next step does all of it.
        mujoco.mj_kinematics(physics.model.ptr, physics.data.ptr)
        mujoco.mj_camlight(physics.model.ptr, physics.data.ptr)

    def resume(self, physics: mjcf.Physics, poses: NDArray) -> None:
        """Go on from [n, 7] poses as if the last push had left the objects there."""
        self.set_poses(physics, poses)
        self._left = np.array(poses)
        self._last_push = None
        self._previous = self._distances = self._to_goal(self._left)

    def _settle(self, physics: mjcf.Physics) -> None:
        """Step until every prop sleeps, which is to say lies still; at most `settle_seconds`."""
        config = self._config.physics
        model, data = physics.model.ptr, physics.data.ptr
        trees = self._trees[self.episode.objects]
        for _ in range(round(config.settle_seconds / (SETTLE_STEPS * config.timestep))):
            if (data.tree_asleep[trees] >= 0).all():
                return
            mujoco.mj_step(model, data, SETTLE_STEPS)
