"""Types for object models, their resting poses and object sources."""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Rest:
    """One stable resting pose on a horizontal table, up to yaw.

    Attributes:
        quat: Orientation (w, x, y, z) at yaw zero; any yaw is equally stable.
        height: Height of the frame origin above the table, metres.
        radius: Largest horizontal distance of any vertex from the origin in this pose, metres.
        probability: Share of random drops that end in this pose; an object's rests sum to 1.
    """

    quat: tuple[float, float, float, float]
    height: float
    radius: float
    probability: float


@dataclass(frozen=True)
class ObjectModel:
    """One catalogue entry at its final scale.

    The frame origin is the volume centroid of the collision pieces, and so the centre of mass at
    uniform density.

    Attributes:
        name: Unique within its catalogue.
        category: Each category belongs to one split only.
        split: "train" or "test".
        vertices: Visual mesh, float32 [V, 3], metres.
        faces: Visual mesh, int32 [F, 3], counter-clockwise from outside.
        uv: Texture coordinates, float32 [V, 2], or None. (0, 0) is the first pixel of the first
            row, as in MuJoCo (v runs the other way in OBJ files).
        texture: uint8 [T, T, 3], or None if the colour is drawn per episode.
        pieces: Hull vertices of the convex collision pieces, each float32 [P, 3], metres.
        mass: Kilograms.
        rests: Stable resting poses, most probable first; at least one.
    """

    name: str
    category: str
    split: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    uv: NDArray[np.float32] | None
    texture: NDArray[np.uint8] | None
    pieces: tuple[NDArray[np.float32], ...]
    mass: float
    rests: tuple[Rest, ...]

    @functools.cached_property
    def hull(self) -> NDArray[np.float32]:
        """Vertices of the visual mesh's convex hull, [K, 3]; only these can lie on its outline."""
        return self.vertices[ConvexHull(self.vertices).vertices]


@dataclass(frozen=True)
class Shape:
    """A mesh with its convex pieces, before scaling and settling.

    Attributes:
        vertices: [V, 3], in the source's frame; metres if the source has a unit.
        faces: [F, 3], counter-clockwise from outside.
        pieces: Convex pieces, each [P, 3].
        uv: [V, 2] as in `ObjectModel`, or None.
        texture: uint8 [T, T, 3], or None.
        footprint: Target footprint in metres for a source without a unit, or None to keep the
            source's size as far as the limits allow.
    """

    vertices: NDArray
    faces: NDArray
    pieces: tuple[NDArray, ...]
    uv: NDArray | None = None
    texture: NDArray[np.uint8] | None = None
    footprint: float | None = None

    def mapped(self, change: Callable[[NDArray], NDArray]) -> Shape:
        """The shape with an affine map applied to all its points [P, 3]."""
        return replace(self, vertices=change(self.vertices), pieces=tuple(map(change, self.pieces)))

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Shape:
        """The shape translated by (x, y, z) metres."""
        return self.mapped(lambda points: points + np.array([x, y, z]))

    def turned(self, axis: str, degrees: float) -> Shape:
        """The shape rotated about a coordinate axis."""
        return self.mapped(Rotation.from_euler(axis, degrees, degrees=True).apply)


@dataclass(frozen=True)
class Recipe:
    """How to build one catalogue entry; `build` does the slow part."""

    name: str
    category: str
    split: str
    build: Callable[[], Shape]


@dataclass(frozen=True)
class Source:
    """A source of objects, registered by name in `sdfgcn/objects/sources/`.

    Attributes:
        recipes: Lists all objects of both splits; may download. Called only to build a cache.
        fingerprint: Text that changes whenever the same settings would yield different objects.
        lenient: Whether to skip objects that cannot be built, with a warning, instead of failing.
    """

    recipes: Callable[[Any], list[Recipe]]  # takes the source's subclass of ObjectsConfig
    fingerprint: Callable[[Any], str] = field(default=lambda cfg: "")
    lenient: bool = False


def name_generator(name: str) -> np.random.Generator:
    """Return a generator seeded by the object's name alone, so that builds are reproducible."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8]))
