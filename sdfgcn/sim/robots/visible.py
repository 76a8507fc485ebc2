"""The robot as recordings draw it: its links' meshes, and their poses during a push."""

from __future__ import annotations

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from sdfgcn.config import RobotConfig
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.robots.robot import Robot
from sdfgcn.task.world import RobotLink, RobotShape

GROUP_VISUAL = 2  # of the Menagerie models, where 3 holds the collision geoms
# Vertices this near to each other are merged: 390,000 become 9,000. Metres.
DETAIL = 0.006


class VisibleRobot:
    """A second model of the robot, which is never stepped; the simulation has no visual geoms.

    Attributes:
        shape: The links' meshes, and their poses at home.
    """

    def __init__(self, robot: Robot) -> None:
        """Compile the robot alone, which takes a second or two."""
        self._robot = robot
        self._physics = mjcf.Physics.from_mjcf_model(robot.mjcf_model)
        robot.after_compile(self._physics, np.random.RandomState(0))
        model = self._physics.model.ptr
        visual = np.flatnonzero((model.geom_group == GROUP_VISUAL) & (model.geom_dataid >= 0))
        # Bodies without a joint in between are one link.
        roots = model.body_weldid[model.geom_bodyid[visual]]
        self._bodies = np.unique(roots)
        home = self.poses(robot.home[None])[0]
        links = tuple(self._link(body, visual[roots == body]) for body in self._bodies)
        self.shape = RobotShape(links, home)

    @classmethod
    def find(cls, config: RobotConfig) -> VisibleRobot | None:
        """The robot that the config names; None if it has no visual geoms."""
        robot = ROBOTS[config.name].visible(config)
        return None if robot is None else cls(robot)

    def poses(self, joints: NDArray) -> NDArray[np.float64]:
        """[T, L, 7] poses of the links at joint positions [T, drives]."""
        data = self._physics.data.ptr
        poses = np.empty((len(joints), len(self._bodies), 7))
        for moment, q in zip(poses, joints, strict=True):
            self._robot.place(self._physics, q)
            mujoco.mj_kinematics(self._physics.model.ptr, data)
            moment[:, :3], moment[:, 3:] = data.xpos[self._bodies], data.xquat[self._bodies]
        return poses

    def _link(self, body: int, geoms: NDArray[np.intp]) -> RobotLink:
        """The mesh of a body's visual geoms, in the frame of the body."""
        model, data = self._physics.model.ptr, self._physics.data.ptr
        all_vertices, all_faces, all_colors, count = [], [], [], 0
        for geom in geoms:
            mesh, material = model.geom_dataid[geom], model.geom_matid[geom]
            points, faces = simplified(*_mesh(model, mesh), DETAIL)
            world = points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            all_vertices.append((world - data.xpos[body]) @ data.xmat[body].reshape(3, 3))
            all_faces.append(faces + count)
            rgba = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
            all_colors.append(
                np.tile(np.round(255.0 * rgba[:3]).astype(np.uint8), (len(points), 1))
            )
            count += len(points)
        return RobotLink(
            name=model.body(body).name.rpartition("/")[2] or "base",
            vertices=np.concatenate(all_vertices).astype(np.float32),
            faces=np.concatenate(all_faces).astype(np.int32),
            colors=np.concatenate(all_colors),
        )


def simplified(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], cell: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """A coarser mesh: the vertices in each cube of a grid become one, at their mean.

    Args:
        vertices: [V, 3] metres.
        faces: [F, 3] vertex indices.
        cell: Side of the cubes, metres.
    """
    _, places = np.unique(np.floor(vertices / cell), axis=0, return_inverse=True)
    places = places.ravel()
    counts = np.bincount(places)
    sums = np.stack([np.bincount(places, weights=axis) for axis in vertices.T], axis=-1)
    merged = places[faces]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (a != c)]
    _, first = np.unique(np.sort(merged, axis=1), axis=0, return_index=True)
    return sums / counts[:, None], merged[np.sort(first)]


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    vertex, face = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]]
    return vertices, model.mesh_face[face : face + model.mesh_facenum[mesh]]
