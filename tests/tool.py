"""Where the fingertips really are, step by step, whatever the robot."""

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from sdfgcn.sim.robots.robot import Robot

DOWN = 0.3  # metres above the table where the tool is looked at


class Fingertips:
    """The lowest points of a robot's closed fingers, as geometry in the compiled model."""

    def __init__(self, physics: mjcf.Physics, robot: Robot):
        """Find the corners of what is lowest when the tool points down."""
        robot.place(physics, robot.solve(np.array([0.0, 0.1, DOWN, 0.0])))
        physics.forward()
        model, data = physics.model.ptr, physics.data.ptr
        self.ngeom = model.ngeom
        self._geoms, self._corners = [], []
        for geom in np.flatnonzero(robot.owns_geom):
            corners = _corners(model, geom)
            heights = _place(data, geom, corners)[:, 2]
            low = corners[heights < DOWN + 0.0005]
            if len(low):
                self._geoms.append(int(geom))
                self._corners.append(low)

    def position(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """[3] the middle of the lowest points, and how low the lowest is, metres."""
        points = np.concatenate(
            [_place(data, g, c) for g, c in zip(self._geoms, self._corners, strict=True)]
        )
        low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
        return np.array([*(0.5 * (low + high)), points[:, 2].min()])

    def across(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """[2] unit vector from one finger to the other."""
        places = [
            _place(data, geom, corners)[:, :2].mean(axis=0)
            for geom, corners in zip(self._geoms, self._corners, strict=True)
        ]
        apart = places[int(np.argmax(np.linalg.norm(places - places[0], axis=1)))] - places[0]
        return apart / np.linalg.norm(apart)

    @contextmanager
    def followed(self) -> Iterator["Followed"]:
        """Look at the fingertips in every simulation step inside the `with` block."""
        seen = Followed(self)
        mujoco.set_mjcb_control(seen.look)
        try:
            yield seen
        finally:
            mujoco.set_mjcb_control(None)


class Followed:
    """Position and direction of the fingers, one entry per simulation step."""

    def __init__(self, tips: Fingertips):
        self._tips = tips
        self.path: list[NDArray[np.float64]] = []
        self.across: list[NDArray[np.float64]] = []

    def look(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """MuJoCo's control callback; it is also called for the arm's own kinematics."""
        if model.ngeom == self._tips.ngeom:
            self.path.append(self._tips.position(data))
            self.across.append(self._tips.across(data))


def _corners(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    """[V, 3] the corners of a mesh or box geom in its own frame; none for other shapes."""
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        return signs * model.geom_size[geom]
    mesh = model.geom_dataid[geom]
    if mesh < 0:
        return np.zeros((0, 3))
    first = model.mesh_vertadr[mesh]
    return model.mesh_vert[first : first + model.mesh_vertnum[mesh]].astype(np.float64)


def _place(data: mujoco.MjData, geom: int, points: NDArray) -> NDArray[np.float64]:
    return points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
