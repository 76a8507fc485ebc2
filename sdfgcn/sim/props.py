"""Props: catalogue objects as composer entities.

All props of a split are compiled into the model once. An episode places some of them on the table
and leaves the others parked, hidden and asleep, so the model is never recompiled.
"""

from __future__ import annotations

import io
import struct

import numpy as np
from dm_control import composer, mjcf
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from sdfgcn.config import PhysicsConfig
from sdfgcn.objects.model import ObjectModel
from sdfgcn.sim.arena import GROUP_COLLISION, GROUP_PARKED

# Contact bits: props collide with the table and each other (bit 0), and with robots (bit 1).
CONTYPE_PROP = 1
CONAFFINITY_PROP = 3
PARKING = np.array([4.0, 0.0, 1.0])  # metres; far from the table, outside the camera's view


class Prop(composer.Entity):
    """One object: a visual mesh and its convex collision pieces on a single body."""

    def _build(self, model: ObjectModel, physics: PhysicsConfig) -> None:
        self.model = model
        self._root = mjcf.RootElement(model=model.name)
        material = add_visual_assets(self._root, model)
        body = self._root.worldbody
        self.visual = body.add(
            "geom",
            name="visual",
            type="mesh",
            mesh="visual",
            group=GROUP_PARKED,
            contype=0,
            conaffinity=0,
            mass=0,
            **({"material": material} if material else {"rgba": [0.6, 0.6, 0.6, 1.0]}),
        )
        # Rolling friction: dry joint friction on the rotation of objects that can roll. MuJoCo's
        # rolling friction per contact (condim 6) would double the time of a push.
        weight = 9.81 * model.mass
        self.rolling_torque = physics.rolling_friction * weight if rolls(model) else 0.0
        volumes = np.array([ConvexHull(piece).volume for piece in model.pieces])
        for i, piece in enumerate(model.pieces):
            self._root.asset.add("mesh", name=f"piece{i}", vertex=piece.ravel())
        self.pieces = [
            body.add(
                "geom",
                name=f"piece{i}",
                type="mesh",
                mesh=f"piece{i}",
                group=GROUP_COLLISION,
                mass=model.mass * volume / volumes.sum(),
                condim=3,
                friction=[physics.sliding_friction, 0.0, 0.0],
                solref=list(physics.solref),
                contype=CONTYPE_PROP,
                conaffinity=CONAFFINITY_PROP,
            )
            for i, (piece, volume) in enumerate(zip(model.pieces, volumes, strict=True))
        ]

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The prop's MJCF tree."""
        return self._root


def rolls(model: ObjectModel) -> bool:
    """Whether the object can roll in any resting pose.

    It can roll if, to tip over an edge of its support (the collision vertices within a millimetre
    of the table), its centre of mass need rise by less than 8% of its height. A prism with 9
    sides rolls, one with 8 does not.
    """
    vertices = np.concatenate(model.pieces)
    for rest in model.rests:
        turned = Rotation.from_quat(rest.quat, scalar_first=True).apply(vertices)
        support = turned[turned[:, 2] < turned[:, 2].min() + 0.001, :2]
        _, _, axes = np.linalg.svd(support - support.mean(axis=0))
        # The origin is the centre of mass; the support is narrowest along the last axis.
        across = support @ axes[-1]
        edge = max(0.0, min(-across.min(), across.max()))
        if np.hypot(rest.height, edge) < 1.08 * rest.height:
            return True
    return False


def add_visual_assets(root: mjcf.RootElement, model: ObjectModel) -> str | None:
    """Add the visual mesh and any texture; return the material's name, None without texture."""
    root.asset.add("mesh", name="visual", file=mjcf.Asset(_msh(model), ".msh"), inertia="shell")
    if model.texture is None:
        return None
    png = io.BytesIO()
    Image.fromarray(model.texture).save(png, format="PNG")
    root.asset.add("texture", name="skin", type="2d", file=mjcf.Asset(png.getvalue(), ".png"))
    root.asset.add("material", name="skin", texture="skin", specular=0.2, shininess=0.2)
    return "skin"


def _msh(model: ObjectModel) -> bytes:
    """The visual mesh in MuJoCo's binary MSH format (compact, and keeps `uv` unchanged)."""
    uv: NDArray = np.zeros((0, 2)) if model.uv is None else model.uv
    header = struct.pack("<4i", len(model.vertices), 0, len(uv), len(model.faces))
    arrays = [
        model.vertices.astype("<f4"),
        uv.astype("<f4"),
        model.faces.astype("<i4"),
    ]
    return header + b"".join(array.tobytes() for array in arrays)
