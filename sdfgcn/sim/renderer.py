"""Pictures of the table: one kept camera, the robot out of view."""

from __future__ import annotations

import numpy as np
from dm_control import mjcf
from dm_control.mujoco.engine import Camera
from dm_control.mujoco.wrapper import MjvOption
from mujoco import mjtObj
from numpy.typing import NDArray

from sdfgcn.sim.arena import CAMERA, GROUP_SCENE


class Renderer:
    """Renders one compiled model from the arena's camera, again and again.

    Robot, collision pieces and parked props are in groups that are not drawn.
    """

    def __init__(self, physics: mjcf.Physics, size: int):
        """Set up for square pictures of `size` pixels."""
        self._option = MjvOption()
        self._option.geomgroup[:] = 0
        self._option.geomgroup[GROUP_SCENE] = 1
        self._option.sitegroup[:] = 0
        self._camera = Camera(physics, height=size, width=size, camera_id=CAMERA)

    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] the RGB picture."""
        return self._camera.render(scene_option=self._option).copy()

    def geom_ids(self) -> NDArray[np.int64]:
        """[H, W] the geom that each pixel shows, -1 for none."""
        segments = self._camera.render(segmentation=True, scene_option=self._option)
        # int(): comparing an array with an enum goes element by element, 10 times the rendering.
        return np.where(segments[..., 1] == int(mjtObj.mjOBJ_GEOM), segments[..., 0], -1)
