"""Solids from which household objects are built, each a mesh with its convex pieces."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from sdfgcn.objects.meshes import mesh_volume
from sdfgcn.objects.model import Shape

Profile = Sequence[tuple[float, float]]  # (radius, z) from bottom to top, metres
ROUND = 32  # vertices of a circle in a visual mesh
SECTORS = 10  # convex sectors around a hollow wall


def join(*parts: Shape) -> Shape:
    """Combine parts, which may overlap, into one shape."""
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    return Shape(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + off for part, off in zip(parts, offsets, strict=True)]),
        tuple(piece for part in parts for piece in part.pieces),
    )


def convex(points: NDArray) -> Shape:
    """Return the convex hull of `points` [P, 3] as a mesh with a single piece."""
    hull = ConvexHull(points)
    number = np.full(len(points), -1)
    number[hull.vertices] = np.arange(len(hull.vertices))
    vertices, faces = points[hull.vertices], number[hull.simplices]
    normals = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Shape(vertices, faces, (vertices,))


def box(x: float, y: float, z: float) -> Shape:
    """Return a box with the given sides (m), centred in x and y, with its bottom at z = 0."""
    return prism([(-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)], z)


def prism(outline: Sequence[tuple[float, float]] | NDArray, z: float) -> Shape:
    """Return a convex outline (x, y) extruded from 0 to `z` metres."""
    flat = np.asarray(outline, float)
    levels = [np.column_stack([flat, np.full(len(flat), level)]) for level in (0.0, z)]
    return convex(np.concatenate(levels))


def circle(radius: float, corners: int, squash: float = 1.0) -> NDArray:
    """Return [corners, 2] points on an ellipse with half axes `radius`, `radius` * `squash` (m)."""
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    return np.column_stack([radius * np.cos(angle), radius * squash * np.sin(angle)])


def ellipsoid(x: float, y: float, z: float) -> Shape:
    """Return an ellipsoid with half axes in metres, centred at the origin."""
    rings = [
        np.column_stack([circle(np.cos(tilt), 12), np.full(12, np.sin(tilt))])
        for tilt in np.deg2rad([-54, -27, 0, 27, 54])
    ]
    poles = np.array([[0, 0, -1.0], [0, 0, 1.0]])
    return convex(np.concatenate([*rings, poles]) * [x, y, z])


def turned_solid(profile: Profile) -> Shape:
    """Revolve `profile` about z into a solid, with one piece per convex run."""
    outline = [(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])]
    pieces = tuple(
        np.concatenate([np.column_stack([circle(r, 16), np.full(16, z)]) for r, z in run])
        for run in _convex_runs(list(profile))
    )
    return _revolved(outline, pieces)


def turned_vessel(profile: Profile, wall: float, base: float) -> Shape:
    """Revolve a profile about z into a hollow vessel, open at the top.

    Args:
        profile: Outer (radius, z) from bottom to top, metres.
        wall: Wall thickness, metres.
        base: Thickness of the bottom, metres.

    Returns:
        Convex wall sectors around an empty interior, and a disc as the bottom.
    """
    floor = profile[0][1] + base
    inner = [(r - wall, max(z, floor)) for r, z in profile]
    outline = [(0.0, profile[0][1]), *profile, *reversed(inner), (0.0, floor)]
    edge = np.linspace(0, 2 * np.pi, SECTORS + 1)
    walls = []
    # The walls start 0.5 mm higher, so that only the base touches the table: the ten sectors of
    # the lowest ring would otherwise add forty contacts.
    profile = [(profile[0][0], profile[0][1] + 0.0005), *profile[1:]]
    for (r0, z0), (r1, z1) in itertools.pairwise(profile):
        for a, b in itertools.pairwise(edge):
            arcs = [
                _arc(radius, z, np.linspace(a, b, count))
                for r, z in ((r0, z0), (r1, z1))
                for radius, count in ((r, 4), (r - wall, 2))
            ]
            walls.append(np.concatenate(arcs))
    r_floor = float(np.interp(floor, [z for _, z in profile], [r for r, _ in profile]))
    disc = np.concatenate(
        [_arc(profile[0][0], floor - base, edge), _arc(r_floor - wall / 2, floor, edge)]
    )
    return _revolved(outline, (*walls, disc))


def rod(path: NDArray, radius: float, squash: float = 1.0) -> Shape:
    """Return a bar of circular (or squashed) cross-section along a path of points.

    Args:
        path: [K, 3] metres; each segment becomes one convex piece.
        radius: Half thickness along the normal of the path's plane, metres.
        squash: Half thickness within the path's plane, relative to `radius`.
    """
    path = np.asarray(path, float)
    closed = np.allclose(path[0], path[-1])
    tangents = np.gradient(path, axis=0)
    if closed:
        tangents[0] = tangents[-1] = path[1] - path[-2]
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    across = np.linalg.svd(path - path.mean(axis=0))[2][2]
    normal = across / np.linalg.norm(across)  # of the path's plane; arbitrary for a straight path
    side = np.cross(tangents, normal)
    flat = circle(radius, 8, squash)
    rings = path[:, None] + flat[:, :1] * normal + flat[:, 1:] * side[:, None]
    return join(*[convex(np.concatenate(pair)) for pair in itertools.pairwise(rings)])


def arc_path(radius: float, start: float, end: float, stretches: int) -> NDArray:
    """Return [stretches + 1, 3] points on an arc in the x-z plane; angles in degrees."""
    angle = np.deg2rad(np.linspace(start, end, stretches + 1))
    return np.column_stack([radius * np.cos(angle), np.zeros_like(angle), radius * np.sin(angle)])


def _arc(radius: float, z: float, angles: NDArray) -> NDArray:
    return np.column_stack(
        [radius * np.cos(angles), radius * np.sin(angles), np.full(len(angles), z)]
    )


def _convex_runs(profile: list[tuple[float, float]]) -> list[list[tuple[float, float]]]:
    """Split a profile where it is concave, so that each run revolves into a convex solid."""
    runs = [profile[:2]]
    for point in profile[2:]:
        (r0, z0), (r1, z1) = runs[-1][-2:]
        if (r1 - r0) * (point[1] - z1) - (z1 - z0) * (point[0] - r1) >= -1e-12:
            runs[-1].append(point)
        else:
            runs.append([(r1, z1), point])
    return runs


def _revolved(outline: Profile, pieces: tuple[NDArray, ...]) -> Shape:
    """Revolve an outline that starts and ends on the axis into a closed mesh."""
    angles = np.linspace(0, 2 * np.pi, ROUND, endpoint=False)
    rings = [_arc(r, z, angles if r > 0 else angles[:1]) for r, z in outline]
    starts = np.cumsum([0] + [len(ring) for ring in rings])
    faces: list[NDArray] = []
    for k in range(len(rings) - 1):
        lower = starts[k] + np.arange(ROUND) % len(rings[k])
        upper = starts[k + 1] + np.arange(ROUND) % len(rings[k + 1])
        after_lower, after_upper = np.roll(lower, -1), np.roll(upper, -1)
        if len(rings[k]) > 1:
            faces.append(np.column_stack([lower, after_lower, upper]))
        if len(rings[k + 1]) > 1:
            faces.append(np.column_stack([after_lower, after_upper, upper]))
    vertices, triangles = np.concatenate(rings), np.concatenate(faces)
    if mesh_volume(vertices, triangles) < 0:
        triangles = triangles[:, ::-1]
    return Shape(vertices, triangles, pieces)
