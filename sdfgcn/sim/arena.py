"""The arena: a table, a light and one fixed camera (paper section VI A)."""

from __future__ import annotations

from dm_control import composer

from sdfgcn.config import ArenaConfig, PhysicsConfig
from sdfgcn.task.camera import camera_model

# Geom groups determine what a picture shows; switching them costs nothing.
GROUP_SCENE = 0  # visible props: in every picture
GROUP_TABLE = 1  # the table: in RGB pictures
# Group 2 holds the visual geoms of the Menagerie models; no picture shows them.
GROUP_COLLISION = 3  # convex pieces: never drawn
GROUP_PARKED = 4  # props not in this episode: never drawn

CAMERA = "overhead"


class Table(composer.Arena):
    """A table top at z = 0, lit without shadows, with a camera above it."""

    def _build(self, arena: ArenaConfig, physics: PhysicsConfig, name: str = "arena") -> None:
        super()._build(name=name)
        root = self.mjcf_model
        root.option.timestep = physics.timestep
        root.option.integrator = "implicitfast"
        root.option.cone = physics.cone
        root.option.impratio = physics.impratio
        root.option.ccd_tolerance = physics.ccd_tolerance
        root.option.noslip_iterations = physics.noslip_iterations
        # Sleeping props cost nothing and do not creep (measured: pushes are 3.6 times faster).
        root.option.flag.sleep = "enable"
        root.option.sleep_tolerance = physics.sleep_tolerance
        root.size.memory = "64M"
        root.compiler.fusestatic = True  # merges the gripper's fixed parts into one body
        # Shadows and multisampling would make a 96x96 picture over 20 times slower.
        root.visual.quality.shadowsize = 0
        root.visual.quality.offsamples = 0
        # A frame buffer of exactly the picture size: a larger one takes longer to clear.
        frame = root.visual.get_children("global")
        frame.set_attributes(offwidth=arena.image_size, offheight=arena.image_size)
        root.visual.headlight.set_attributes(
            ambient=[0.4] * 3, diffuse=[0.4] * 3, specular=[0.1] * 3
        )
        root.statistic.set_attributes(extent=1.0, center=[0, 0, 0])
        root.worldbody.add(
            "light", name="lamp", pos=[0.3, -0.3, 1.5], dir=[-0.2, 0.2, -1.0], castshadow=False
        )
        root.worldbody.add(
            "geom",
            name="table",
            type="plane",
            # For contacts the plane is infinite; it is drawn as a square that fills the picture.
            size=[1.5, 1.5, 0.05],
            rgba=arena.table_rgba,
            group=GROUP_TABLE,
            friction=[physics.sliding_friction, 0.0, 0.0],
            solref=list(physics.solref),
            contype=1,
            conaffinity=1,
        )
        camera = camera_model(arena)
        root.worldbody.add(
            "camera",
            name=CAMERA,
            pos=camera.position,
            xyaxes=[*camera.rotation[:, 0], *camera.rotation[:, 1]],
            fovy=arena.camera_fovy,
        )
