"""The rearrangement task: props on the table, a goal, one push per control step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from dm_control import composer, mjcf
from mujoco import mjtSleepPolicy
from numpy.typing import NDArray

from sdfgcn.config import EnvConfig
from sdfgcn.objects.model import ObjectModel
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.arena import GROUP_PARKED, GROUP_SCENE, Table
from sdfgcn.sim.episode import EpisodeSpec
from sdfgcn.sim.props import CONAFFINITY_PROP, CONTYPE_PROP, PARKING, Prop
from sdfgcn.sim.push import PushPrimitive
from sdfgcn.sim.tape import Tape
from sdfgcn.task.world import PushCommand, PushResult

READY_TO_SLEEP = -1  # MuJoCo increments tree_asleep up to this value while a tree is still
SETTLE_STEPS = 5  # simulation steps between checks whether the props are at rest


class RearrangementTask(composer.Task):
    """An episode's props on the table and a robot that pushes them (paper section IV).

    Composer builds, compiles and resets the task. Call `begin` with an episode before each reset;
    `execute` runs a push. Rewards are computed by the environment.
    """

    def __init__(self, config: EnvConfig, catalogue: Sequence[ObjectModel]):
        """Build the world: table, robot and every prop of the catalogue."""
        self._config = config
        self._table = Table(arena=config.arena, physics=config.physics)
        self.robot = ROBOTS[config.robot.name](config=config.robot)
        self._table.attach(self.robot)
        self._props = [Prop(model=model, physics=config.physics) for model in catalogue]
        for i, prop in enumerate(self._props):
            # Start parked: props piled up at the origin would all be in contact.
            self._table.add_free_entity(prop).pos = PARKING + np.array([0.5 * i, 0.0, 0.0])
        self._primitive = PushPrimitive(config.push, config.arena, self.robot)
        self.control_timestep = config.physics.timestep
        self._episode: EpisodeSpec | None = None

    @property
    def root_entity(self) -> composer.Entity:
        """The table."""
        return self._table

    def after_compile(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Look up the addresses of the props in the compiled model."""
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

    def begin(self, episode: EpisodeSpec) -> None:
        """Set the episode for the next reset."""
        self._episode = episode

    @property
    def episode(self) -> EpisodeSpec:
        """The running episode."""
        if self._episode is None:
            raise RuntimeError("begin() was not called before the first reset")
        return self._episode

    # ------------------------------------------------------------------ composer's hooks

    def initialize_episode(
        self, physics: mjcf.Physics, random_state: np.random.RandomState
    ) -> None:
        """Place the episode's props at their start, let them settle, and park the others."""
        del random_state
        self._dress(physics)
        self.set_poses(physics, self.episode.start, resting=False)
        self._settle(physics)
        self.set_poses(physics, self.poses(physics))

    def _dress(self, physics: mjcf.Physics) -> None:
        """Show and colour the episode's props; park the others.

        Parked props are hidden, cannot collide and sleep from the start, so that they cost almost
        nothing however large the catalogue is.
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

    def get_reward(self, physics: mjcf.Physics) -> float:
        """Required by composer; the environment computes the reward (`sdfgcn.envs.reward`)."""
        del physics
        return 0.0

    # ------------------------------------------------------------------ pushing

    def execute(
        self, physics: mjcf.Physics, command: PushCommand, record: bool = False
    ) -> PushResult:
        """Push, and let the props come to rest.

        The final simulation state depends on the props' poses alone: velocities, warm starts and
        sleep are cleared, so that restoring saved poses restores the state.

        Args:
            physics: Stepped in place.
            command: The push.
            record: Whether the result includes the motion; nothing else depends on it.
        """
        objects = self._qpos[self.episode.objects]
        tape = Tape(self.robot.joint_qpos, objects) if record else None
        options = physics.model.opt
        options.noslip_iterations = 0  # off while the tool moves, see conf/env/paper.yaml
        result = self._primitive.execute(physics, command, tape)
        options.noslip_iterations = self._config.physics.noslip_iterations
        if result.status != "unreachable":
            self._settle(physics, tape)
        self.set_poses(physics, self.poses(physics))
        return result if tape is None else replace(result, motion=tape.motion())

    def poses(self, physics: mjcf.Physics) -> NDArray[np.float64]:
        """[n, 7] true poses in slot order: xyz in metres, quaternion w, x, y, z."""
        return physics.data.qpos[self._qpos[self.episode.objects]].copy()

    # ------------------------------------------------------------------ placing and settling

    def set_poses(self, physics: mjcf.Physics, poses: NDArray, resting: bool = True) -> None:
        """Place the episode's objects at [n, 7] poses, without velocity, with the robot at home.

        Args:
            physics: Changed in place.
            poses: xyz in metres, quaternion w, x, y, z.
            resting: Whether the objects are known to be at rest in these poses. If so, they fall
                asleep at the first step without motion instead of after MuJoCo's ten.
        """
        # Not physics.reset(), which runs the whole forward pass again.
        mujoco.mj_resetData(physics.model.ptr, physics.data.ptr)
        physics.data.qpos[self._qpos[self.episode.objects]] = poses
        if resting:
            physics.data.tree_asleep[self._trees[self.episode.objects]] = READY_TO_SLEEP
        self.robot.place(physics, self.robot.home)
        # Only the part of the forward pass that rendering needs; the next step does the rest.
        mujoco.mj_kinematics(physics.model.ptr, physics.data.ptr)
        mujoco.mj_camlight(physics.model.ptr, physics.data.ptr)

    def _settle(self, physics: mjcf.Physics, tape: Tape | None = None) -> None:
        """Step until every prop sleeps, for at most `settle_seconds`."""
        config = self._config.physics
        model, data = physics.model.ptr, physics.data.ptr
        trees = self._trees[self.episode.objects]
        for _ in range(round(config.settle_seconds / (SETTLE_STEPS * config.timestep))):
            if (data.tree_asleep[trees] >= 0).all():
                return
            mujoco.mj_step(model, data, SETTLE_STEPS)
            if tape is not None:
                tape.note_objects(data)
