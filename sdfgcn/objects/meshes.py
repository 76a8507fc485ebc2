"""Triangle meshes: welding, reduction, volume (numpy and scipy only)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def weld(triangles: NDArray) -> tuple[NDArray, NDArray]:
    """Turn a triangle soup [F, 3, 3] into vertices [V, 3] and faces [F, 3] with shared corners."""
    vertices, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    return vertices, faces[_not_degenerate(faces)]


def decimate(
    vertices: NDArray, faces: NDArray, uv: NDArray | None, max_faces: int
) -> tuple[NDArray, NDArray, NDArray | None]:
    """Reduce a mesh to at most `max_faces` by vertex clustering, finest grid that fits.

    Vertices merge only when they share a grid cell, the octant of their normals (so the two
    sides of a thin wall stay apart) and their texture chart (so a seam stays sharp).

    Args:
        vertices: [V, 3].
        faces: [F, 3].
        uv: [V, 2] or None.
        max_faces: Upper limit.

    Returns:
        vertices, faces and uv of the reduced mesh; the input itself if it is small enough.
    """
    if len(faces) <= max_faces:
        return vertices, faces, uv
    charts = np.zeros(len(vertices), int) if uv is None else _charts(len(vertices), faces)
    labels = np.column_stack([_normals(vertices, faces) > 0, charts])
    size = float(np.ptp(vertices, axis=0).max())
    low, high = 4, 512  # cells along the longest side
    best = _cluster(vertices, faces, uv, labels, size / low)
    while high - low > 1:
        cells = (low + high) // 2
        trial = _cluster(vertices, faces, uv, labels, size / cells)
        if len(trial[1]) <= max_faces:
            low, best = cells, trial
        else:
            high = cells
    return best


def _cluster(
    vertices: NDArray, faces: NDArray, uv: NDArray | None, labels: NDArray, cell: float
) -> tuple[NDArray, NDArray, NDArray | None]:
    keys = np.column_stack([np.floor((vertices - vertices.min(axis=0)) / cell).astype(int), labels])
    _, index = np.unique(keys, axis=0, return_inverse=True)
    index = index.ravel()
    count = np.bincount(index)[:, None]
    both = vertices if uv is None else np.column_stack([vertices, uv])
    means = np.column_stack([np.bincount(index, weights=column) for column in both.T]) / count
    reduced = index[faces]
    reduced = reduced[_not_degenerate(reduced)]
    # The same face may come from several old ones: keep one of each, turned to a standard start.
    turn = reduced.argmin(axis=1)
    reduced = np.take_along_axis(reduced, (turn[:, None] + np.arange(3)) % 3, axis=1)
    reduced = np.unique(reduced, axis=0)
    used, reduced = np.unique(reduced, return_inverse=True)
    means = means[used]
    return means[:, :3], reduced.reshape(-1, 3), None if uv is None else means[:, 3:]


def _normals(vertices: NDArray, faces: NDArray) -> NDArray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, faces[:, k], face_normals)
    return out


def _charts(n: int, faces: NDArray) -> NDArray:
    """Number the connected parts of the index graph; scanners double vertices at UV seams."""
    rows = np.concatenate([faces[:, 0], faces[:, 1]])
    columns = np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def _not_degenerate(faces: NDArray) -> NDArray:
    a, b, c = faces.T
    return (a != b) & (b != c) & (c != a)


def mesh_volume(vertices: NDArray, faces: NDArray) -> float:
    """Return the signed volume (m^3); negative where the faces are inside out."""
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
