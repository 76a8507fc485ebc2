"""How the robot and the props move during a push, noted for a film."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from sdfgcn.task.world import Motion


class Tape:
    """Notes moments of a push; it reads the simulation and changes nothing."""

    def __init__(self, robot: NDArray[np.integer], objects: NDArray[np.integer]) -> None:
        """Say where in `qpos` they stand.

        Args:
            robot: [J] addresses of the robot's joints.
            objects: [n, 7] addresses of the objects' poses.
        """
        self._addresses = robot, objects
        self._robot: list[NDArray[np.float64]] = []
        self._poses: list[NDArray[np.float64]] = []

    def note(self, data: mujoco.MjData) -> None:
        """Note where everything is now."""
        robot, objects = self._addresses
        self._robot.append(data.qpos[robot])
        self._poses.append(data.qpos[objects])

    def note_objects(self, data: mujoco.MjData) -> None:
        """Note the objects alone; the robot, which has jumped home, is left where it last was."""
        if self._robot:
            self._robot.append(self._robot[-1])
            self._poses.append(data.qpos[self._addresses[1]])

    def motion(self) -> Motion:
        """Everything noted so far."""
        robot, objects = self._addresses
        return Motion(
            robot=np.reshape(self._robot, (len(self._robot), len(robot))),
            poses=np.reshape(self._poses, (len(self._poses), *objects.shape)),
        )
