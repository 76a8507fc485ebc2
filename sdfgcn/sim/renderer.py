"""Rendering of the table from a fixed camera, without the robot."""

from __future__ import annotations

import mujoco
import numpy as np
from dm_control import mjcf
from dm_control.mujoco.engine import Camera
from dm_control.mujoco.wrapper import MjvOption
from mujoco import mjtObj, mjtRndFlag
from numpy.typing import NDArray

from sdfgcn.sim.arena import CAMERA, GROUP_SCENE, GROUP_TABLE

GEOM = int(mjtObj.mjOBJ_GEOM)  # a plain int, because comparing with the enum is slower
IDS_AS_COLORS = {mjtRndFlag.mjRND_SEGMENT: True, mjtRndFlag.mjRND_IDCOLOR: True}


class Renderer:
    """Renders a compiled model from the arena's camera.

    The robot, collision pieces and parked props are in geom groups that are not drawn.
    """

    def __init__(self, physics: mjcf.Physics, size: int):
        """Set up for square pictures with sides of `size` pixels."""
        self._physics = physics
        self._rgb = showing(GROUP_TABLE, GROUP_SCENE)
        self._props = showing(GROUP_SCENE)
        self._camera = Camera(physics, height=size, width=size, camera_id=CAMERA)
        self._rectangle = mujoco.MjrRect(0, 0, size, size)
        self._colors = np.zeros((size, size, 3), dtype=np.uint8)

    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] the RGB picture."""
        return self._camera.render(scene_option=self._rgb).copy()

    def geom_ids(self) -> NDArray[np.int64]:
        """[H, W] the id of the prop geom at each pixel, -1 for none."""
        # Equivalent to Camera.render(segmentation=True), which takes 50% longer.
        self._camera.update(self._props)
        scene = self._camera.scene
        with scene.override_flags(IDS_AS_COLORS), self._physics.contexts.gl.make_current() as gl:
            gl.call(self._render)
        ids = np.full(scene.ngeom + 1, -1)
        for geom in scene.ptr.geoms[: scene.ngeom]:
            if geom.objtype == GEOM:
                ids[geom.segid + 1] = geom.objid
        # Colours encode the segment id + 1, lowest byte first; black is background.
        return ids[self._colors[::-1] @ np.array([1, 2**8, 2**16])]

    def _render(self) -> None:
        """Draw the scene and read its colours, bottom row first; runs in the OpenGL thread."""
        context = self._physics.contexts.mujoco.ptr
        mujoco.mjr_render(self._rectangle, self._camera.scene.ptr, context)
        mujoco.mjr_readPixels(self._colors, None, self._rectangle, context)


def showing(*groups: int) -> MjvOption:
    """Options that draw only the geoms of these groups."""
    option = MjvOption()
    option.geomgroup[:] = 0
    option.geomgroup[list(groups)] = 1
    option.sitegroup[:] = 0
    return option
