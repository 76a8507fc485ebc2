"""A second model of an episode, for looking at: robot, objects and goals from any side.

The task's own model has no visual meshes of the robot, and its pictures leave the robot out. This
one is never stepped: `show` places everything, and pictures are taken of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from dm_control.mujoco.engine import Camera
from numpy.typing import NDArray

from sdfgcn.config import RobotConfig
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.props import add_visual_assets
from sdfgcn.sim.renderer import showing
from sdfgcn.sim.robots.visible import GROUP_VISUAL
from sdfgcn.task.camera import CameraModel
from sdfgcn.task.world import Truth

# Geom groups, which a picture shows or leaves out.
GROUP_SCENE = 0  # the table and the objects
GROUP_GHOST = 1  # the objects at their goals, translucent
CAMERA = "film"


@dataclass(frozen=True)
class Look:
    """How a film looks.

    Attributes:
        height: Of the picture, pixels.
        width: Of the picture, pixels.
        samples: Samples of each pixel, against jagged edges; 0 for none.
        shadows: Side of the shadow map, pixels; 0 for no shadows.
        table_rgba: Colour of the table, 0 to 1.
        ghost_alpha: Opacity of the objects at their goals, 0 to 1.
    """

    height: int
    width: int
    samples: int
    shadows: int
    table_rgba: list[float]
    ghost_alpha: float


class FilmScene:
    """The robot, an episode's objects and their goals on a table, rendered from a camera."""

    def __init__(self, robot: RobotConfig, truth: Truth, camera: CameraModel, look: Look) -> None:
        """Compile the scene; the visual meshes of an arm take seconds."""
        self._look = look
        root = _stage(camera, look)
        build = ROBOTS.find(robot.name)
        self._robot = build.visible(robot) or build(config=robot)
        root.attach(self._robot.mjcf_model)
        added = [_add_object(root, slot, truth, look) for slot in range(len(truth.objects))]
        free, self._ghosts = zip(*added, strict=True)
        self._physics = mjcf.Physics.from_mjcf_model(root)
        self._poses = np.reshape(self._physics.bind(free).qposadr, (len(free), -1))[:, :1]
        self._poses = self._poses + np.arange(7)
        self._show_something(self._robot.mjcf_model)
        self._robot.after_compile(self._physics, np.random.RandomState(0))
        self.home = self._robot.home
        self._camera = Camera(self._physics, look.height, look.width, CAMERA)

    def show(self, robot: NDArray[np.float64], poses: NDArray[np.float64]) -> None:
        """Place the robot's drives at positions [J] and the objects at [n, 7] poses."""
        data = self._physics.data
        self._robot.place(self._physics, robot)
        data.qpos[self._poses] = poses
        mujoco.mj_kinematics(self._physics.model.ptr, data.ptr)
        mujoco.mj_camlight(self._physics.model.ptr, data.ptr)

    def picture(self) -> NDArray[np.uint8]:
        """[H, W, 3] what the camera sees."""
        groups = showing(GROUP_SCENE, GROUP_GHOST, GROUP_VISUAL)
        return self._camera.render(scene_option=groups).copy()

    def goal_masks(self) -> NDArray[np.bool_]:
        """[n, H, W] where each object would be seen at its goal, if nothing else were there."""
        found = self._camera.render(scene_option=showing(GROUP_GHOST), segmentation=True)
        geoms = self._physics.bind(self._ghosts).element_id
        return found[..., 0] == np.reshape(geoms, (-1, 1, 1))

    def close(self) -> None:
        """Free the model and the rendering context."""
        self._physics.free()

    def _show_something(self, robot: mjcf.RootElement) -> None:
        """Show the collision geoms of a robot that has no others."""
        geoms = self._physics.bind(robot.find_all("geom"))
        if not (geoms.group == GROUP_VISUAL).any():
            geoms.group = GROUP_VISUAL


def _stage(camera: CameraModel, look: Look) -> mjcf.RootElement:
    """A lit table with a camera."""
    root = mjcf.RootElement(model="film")
    root.visual.quality.set_attributes(shadowsize=look.shadows, offsamples=look.samples)
    frame = root.visual.get_children("global")
    frame.set_attributes(offheight=look.height, offwidth=look.width)
    root.visual.headlight.set_attributes(ambient=[0.35] * 3, diffuse=[0.3] * 3, specular=[0.1] * 3)
    root.statistic.set_attributes(extent=1.0, center=[0, 0, 0])
    root.worldbody.add(
        "light",
        name="lamp",
        type="directional",
        pos=[0.6, 0.4, 1.6],
        dir=[-0.35, -0.25, -1.0],
        diffuse=[0.5] * 3,
        specular=[0.2] * 3,
        castshadow=look.shadows > 0,
    )
    root.worldbody.add(
        "geom", type="plane", size=[3, 3, 0.05], rgba=look.table_rgba, group=GROUP_SCENE
    )
    root.worldbody.add(
        "camera",
        name=CAMERA,
        pos=camera.position,
        xyaxes=[*camera.rotation[:, 0], *camera.rotation[:, 1]],
        fovy=np.degrees(camera.fovy),
    )
    return root


def _add_object(root: mjcf.RootElement, slot: int, truth: Truth, look: Look) -> tuple[Any, Any]:
    """Add an object and its ghost at its goal; return its joint, and the geom of the ghost."""
    model, pose = truth.objects[slot], truth.goal_poses[slot]
    prop = mjcf.RootElement(model=f"object{slot}")
    material = add_visual_assets(prop, model)
    color = [1.0] * 3 if material else list(truth.colors[slot][:3])  # no tint on a texture
    skin = {"material": material} if material else {}
    common = {"type": "mesh", "mesh": "visual", "contype": 0, "conaffinity": 0, **skin}
    prop.worldbody.add(
        "geom", name="visual", group=GROUP_SCENE, rgba=[*color, 1.0], mass=1.0, **common
    )
    joint = root.attach(prop).add("freejoint")
    ghost = root.worldbody.add("body", name=f"goal{slot}", pos=pose[:3], quat=pose[3:])
    common |= {"mesh": prop.find("mesh", "visual")}
    if material:
        common |= {"material": prop.find("material", material)}
    shown = ghost.add("geom", group=GROUP_GHOST, rgba=[*color, look.ghost_alpha], **common)
    return joint, shown
