"""A floating, position-driven gripper: the fast robot for training."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from sdfgcn.config import RobotConfig, number, vector
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.robots.robot import TCP_OFFSET, Robot, load_fixed_gripper, prepare

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}


@dataclass
class GripperConfig(RobotConfig):
    """Stiffness and force limit of the drives."""

    home: list[float] = vector(4, -10, 10)
    stiffness: float = number(1, 1_000_000)
    yaw_stiffness: float = number(1, 1_000_000)
    force_limit: float = number(1, 1_000_000)


@ROBOTS.register("gripper", config=GripperConfig)
class FloatingGripper(Robot):
    """A 2F-85 on three slides and a vertical hinge with stiff position drives."""

    teleports = True  # simulating a free descent would only cost time

    def _build(self, config: GripperConfig, visible: bool = False) -> None:
        self._config = config
        self._root = mjcf.RootElement(model="gripper")
        carriage = self._root.worldbody.add("body", name="carriage")
        carriage.add("inertial", pos=[0, 0, 0], mass=1.0, diaginertia=[0.01, 0.01, 0.01])
        self._joints = [
            carriage.add("joint", name=name, type="slide", axis=axis) for name, axis in AXES.items()
        ]
        self._joints.append(carriage.add("joint", name="yaw", type="hinge", axis=[0, 0, 1]))
        prepare(self._root)
        # Half a turn about x, to point down.
        mount = carriage.add("site", name="mount", pos=[0, 0, TCP_OFFSET], quat=[0, 1, 0, 0])
        self.gripper = load_fixed_gripper(visible)
        mount.attach(self.gripper)
        stiffness = [config.stiffness] * 3 + [config.yaw_stiffness]
        self._actuators = [
            self._root.actuator.add(
                "general",
                name=joint.name,
                joint=joint,
                biastype="affine",
                gainprm=[kp],
                biasprm=[0, -kp, -kp * config.lead],
                forcelimited=True,
                forcerange=[-config.force_limit, config.force_limit],
            )
            for joint, kp in zip(self._joints, stiffness, strict=True)
        ]

    @classmethod
    def visible(cls, config: RobotConfig) -> Self:
        """See `Robot`."""
        return cls(config=config, visible=True)

    def solve(self, pose: NDArray, near: NDArray | None = None) -> NDArray:
        """Return the pose itself, which equals the joint positions; every pose is reachable."""
        del near
        return np.asarray(pose, dtype=np.float64)
