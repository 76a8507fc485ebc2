"""Triangle meshes: welding, reduction, volume (numpy and scipy only)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components


def weld(triangles: NDArray) -> tuple[NDArray, NDArray]:
    """Turn a triangle soup [F, 3, 3] into vertices [V, 3] and faces [F, 3] with shared vertices."""
    vertices, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    return vertices, faces[_not_degenerate(faces)]


def decimate(
    vertices: NDArray, faces: NDArray, uv: NDArray | None, max_faces: int
) -> tuple[NDArray, NDArray, NDArray | None]:
    """Reduce a mesh ([V, 3], [F, 3], uv [V, 2] or None) to at most `max_faces` faces.

    Vertices are clustered on the finest grid that meets the limit.

    Vertices merge if they share a grid cell and have similar normals, so the two sides of a thin
    wall stay apart. Each cluster's vertex minimises the squared distance to the planes of its
    faces (quadric error, Lindstrom 2000), so edges and corners stay sharp. At a texture seam the
    charts share positions but keep their own uv, so no cracks open.

    Returns:
        Vertices, faces and uv of the reduced mesh, or the input if it is small enough.
    """
    if len(faces) <= max_faces:
        return vertices, faces, uv
    quadrics, normals = _quadrics(vertices, faces)
    charts = np.zeros(len(vertices), int) if uv is None else _charts(len(vertices), faces)
    size = float(np.ptp(vertices, axis=0).max())
    low, high = 4, 512  # cells along the longest side
    best = _cluster(vertices, faces, normals, charts, size / low)
    while high - low > 1:
        cells = (low + high) // 2
        trial = _cluster(vertices, faces, normals, charts, size / cells)
        if len(trial[2]) <= max_faces:
            low, best = cells, trial
        else:
            high = cells
    places, corners, reduced = best
    placed = _best_points(vertices, quadrics, places)
    used, reduced = np.unique(reduced, return_inverse=True)
    first = np.unique(corners, return_index=True)[1]  # one original vertex of each new one
    new_uv = None if uv is None else _means(uv, corners)[used]
    return placed[places[first[used]]], reduced.reshape(-1, 3), new_uv


def _cluster(
    vertices: NDArray, faces: NDArray, normals: NDArray, charts: NDArray, cell: float
) -> tuple[NDArray, NDArray, NDArray]:
    """Cluster of each vertex [V], cluster and chart of each vertex [V], remaining faces [G, 3]."""
    grid = np.floor((vertices - vertices.min(axis=0)) / cell)
    keys = np.column_stack([grid, np.rint(normals)]).astype(int)
    places = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    pairs = np.column_stack([places, charts])
    corners = np.unique(pairs, axis=0, return_inverse=True)[1].ravel()
    kept = faces[_not_degenerate(places[faces])]
    # Several faces may collapse into one: rotate corners to a canonical order, then keep one.
    spots = places[kept]
    order = (spots.argmin(axis=1)[:, None] + np.arange(3)) % 3
    turned = np.take_along_axis(spots, order, axis=1)
    first = np.unique(turned, axis=0, return_index=True)[1]
    return places, corners, corners[kept[first]]


def _best_points(vertices: NDArray, quadrics: NDArray, places: NDArray) -> NDArray:
    """[K, 3] the point of each cluster nearest to the planes of all its faces."""
    means = _means(vertices, places)
    total = np.zeros((len(means), 3, 4))
    np.add.at(total, places, quadrics)
    matrix, vector = total[:, :, :3], total[:, :, 3]
    residual = vector - np.einsum("kij,kj->ki", matrix, means)
    step = np.einsum("kij,kj->ki", np.linalg.pinv(matrix, rcond=0.02, hermitian=True), residual)
    # If the planes are almost parallel, the point may lie far away: clip it to the cluster.
    low, high = np.full_like(means, np.inf), np.full_like(means, -np.inf)
    np.minimum.at(low, places, vertices)
    np.maximum.at(high, places, vertices)
    return np.clip(means + step, low, high)


def _quadrics(vertices: NDArray, faces: NDArray) -> tuple[NDArray, NDArray]:
    """Per vertex: sum of n n^T and n (n.p) over its faces [V, 3, 4], and unit normal [V, 3].

    Vertices duplicated at a texture seam share both.
    """
    _, index = np.unique(vertices, axis=0, return_inverse=True)
    corners = index.ravel()[faces]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)  # length is twice the area, so faces are weighted by area
    unit = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    plane = np.concatenate([unit, np.einsum("ij,ij->i", unit, a)[:, None]], axis=1)
    weighted = normals[:, :, None] * plane[:, None, :]
    quadrics = np.zeros((index.max() + 1, 3, 4))
    total = np.zeros((index.max() + 1, 3))
    for k in range(3):
        np.add.at(quadrics, corners[:, k], weighted)
        np.add.at(total, corners[:, k], normals)
    total /= np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20)
    return quadrics[index.ravel()], total[index.ravel()]


def _means(values: NDArray, index: NDArray) -> NDArray:
    count = np.bincount(index)[:, None]
    return np.column_stack([np.bincount(index, weights=column) for column in values.T]) / count


def _charts(n: int, faces: NDArray) -> NDArray:
    """[n] connected component of each vertex; scanners duplicate vertices at uv seams."""
    rows = np.concatenate([faces[:, 0], faces[:, 1]])
    columns = np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def _not_degenerate(faces: NDArray) -> NDArray:
    a, b, c = faces.T
    return (a != b) & (b != c) & (c != a)


def mesh_volume(vertices: NDArray, faces: NDArray) -> float:
    """Return the signed volume (m^3); negative if the faces are inside out."""
    a, b, c = (vertices[faces[:, k]].astype(float) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)
