"""The types of this package: object models with their resting poses, and sources of objects."""

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
        quat: Orientation (w, x, y, z) at yaw zero; turn it about the vertical freely.
        height: Frame origin above the table, metres.
        radius: Largest horizontal distance of any vertex from the origin in this pose, metres.
        probability: Share of random drops that end in this pose; the rests of an object sum to 1.
    """

    quat: tuple[float, float, float, float]
    height: float
    radius: float
    probability: float


@dataclass(frozen=True)
class ObjectModel:
    """One catalogue entry, already scaled; metres, kilograms.

    The frame origin is the volume centroid of the collision pieces, which makes it the centre of
    mass of a body of uniform density.

    Attributes:
        name: Unique within its catalogue.
        category: Categories are disjoint between the splits.
        split: "train" or "test".
        vertices: Visual mesh, float32 [V, 3].
        faces: Visual mesh, int32 [F, 3], counter-clockwise from outside.
        uv: Texture coordinates, float32 [V, 2], or None. (0, 0) is the first pixel of the first
            row, as MuJoCo reads it (in an OBJ file v runs the other way).
        texture: uint8 [T, T, 3], or None where the colour is drawn per episode.
        pieces: Convex collision pieces, each its hull vertices, float32 [P, 3].
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
        """Vertices of the visual mesh's convex hull, [K, 3]; only they can lie on its outline."""
        return self.vertices[ConvexHull(self.vertices).vertices]


@dataclass(frozen=True)
class Shape:
    """A mesh with its convex pieces, before it is scaled and settled.

    Attributes:
        vertices: [V, 3], in the source's own frame; metres where the source has a unit.
        faces: [F, 3], counter-clockwise from outside.
        pieces: Convex pieces, each [P, 3].
        uv: [V, 2] as in `ObjectModel`, or None.
        texture: uint8 [T, T, 3], or None.
        footprint: Wanted footprint in metres for a source without a unit, or None to keep the
            size that the source gives as far as the limits allow.
    """

    vertices: NDArray
    faces: NDArray
    pieces: tuple[NDArray, ...]
    uv: NDArray | None = None
    texture: NDArray[np.uint8] | None = None
    footprint: float | None = None

    def mapped(self, change: Callable[[NDArray], NDArray]) -> Shape:
        """The shape with all its points [P, 3] changed by an affine map."""
        return replace(self, vertices=change(self.vertices), pieces=tuple(map(change, self.pieces)))

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Shape:
        """The shape shifted by metres."""
        return self.mapped(lambda points: points + np.array([x, y, z]))

    def turned(self, axis: str, degrees: float) -> Shape:
        """The shape turned about a coordinate axis through the origin."""
        return self.mapped(Rotation.from_euler(axis, degrees, degrees=True).apply)


@dataclass(frozen=True)
class Recipe:
    """How to make one catalogue entry; `build` does the slow part."""

    name: str
    category: str
    split: str
    build: Callable[[], Shape]


@dataclass(frozen=True)
class Source:
    """Where objects come from; `sdfgcn/objects/sources/` registers each by name.

    Attributes:
        recipes: Lists every object of both splits; may download. Called only to build a cache.
        fingerprint: Text that changes when the same settings would give other objects.
        lenient: Leave out an object that cannot be built, with a warning, instead of failing.
    """

    recipes: Callable[[Any], list[Recipe]]  # takes the source's own subclass of ObjectsConfig
    fingerprint: Callable[[Any], str] = field(default=lambda cfg: "")
    lenient: bool = False


def name_generator(name: str) -> np.random.Generator:
    """Return a generator that depends on the object's name alone, so that builds agree."""
    return np.random.default_rng(int.from_bytes(hashlib.sha256(name.encode()).digest()[:8]))
