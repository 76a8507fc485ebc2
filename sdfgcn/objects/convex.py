"""Convex pieces: hulls, volumes, merging and cutting (numpy and scipy only)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist


def hull_volume_centroid(points: NDArray) -> tuple[float, NDArray]:
    """Return the volume (m^3) and volume centroid [3] of the convex hull of `points` [P, 3]."""
    hull = ConvexHull(points)
    apex = points[hull.vertices].mean(axis=0)
    corners = points[hull.simplices] - apex
    volumes = np.abs(np.linalg.det(corners)) / 6.0
    centroids = apex + corners.sum(axis=1) / 4.0
    return float(volumes.sum()), (volumes[:, None] * centroids).sum(axis=0) / volumes.sum()


def compound_volume_centroid(pieces: Sequence[NDArray]) -> tuple[float, NDArray]:
    """Return the total volume (m^3) and centroid [3] of convex pieces; overlaps count twice.

    MuJoCo also counts overlaps twice when it derives a body's inertia from its geoms.
    """
    parts = [hull_volume_centroid(piece) for piece in pieces]
    total = sum(volume for volume, _ in parts)
    return total, np.sum([volume * centre for volume, centre in parts], axis=0) / total


def hull_vertices(points: NDArray, limit: int) -> NDArray:
    """Approximate the hull of `points` [P, 3] with at most `limit` (>= 8) vertices.

    Greedy: each step adds the vertex farthest outside the hull so far. Dropping vertices shrinks
    round shapes, so the result is scaled about its mean to the original volume.
    """
    full = ConvexHull(points)
    vertices = points[full.vertices]
    if len(vertices) <= limit:
        return vertices
    axes = np.linalg.svd(vertices - vertices.mean(axis=0), full_matrices=False)[2]
    signs = np.array(list(itertools.product((-1, 0, 1), repeat=3)))
    # Start from the extremes along the principal axes and the diagonals between them.
    chosen = list(dict.fromkeys((vertices @ (signs @ axes).T).argmax(axis=0).tolist()))[:limit]
    while len(chosen) < limit:
        equations = ConvexHull(vertices[chosen]).equations
        outside = (vertices @ equations[:, :3].T + equations[:, 3]).max(axis=1)
        outside[chosen] = -np.inf
        chosen.append(int(np.argmax(outside)))
    kept, middle = vertices[chosen], vertices[chosen].mean(axis=0)
    return middle + (kept - middle) * np.cbrt(full.volume / ConvexHull(kept).volume)


def diameter(points: NDArray) -> float:
    """Return the largest distance between any two of `points` [P, 2 or 3], metres."""
    return float(pdist(points[ConvexHull(points).vertices]).max())


def merge_pieces(pieces: Sequence[NDArray], limit: int) -> list[NDArray]:
    """Merge convex pieces until at most `limit` remain, filling as little space as possible.

    Each step merges the two pieces whose joint hull adds the least volume, so neighbours along a
    wall merge while hollows stay open.
    """
    parts = [(np.asarray(piece), hull_volume_centroid(piece)[0]) for piece in pieces]
    added: dict[tuple[int, int], float] = {}
    alive = list(range(len(parts)))

    def cost(i: int, j: int) -> float:
        key = (min(i, j), max(i, j))
        if key not in added:
            both = ConvexHull(np.concatenate([parts[i][0], parts[j][0]])).volume
            added[key] = both - parts[i][1] - parts[j][1]
        return added[key]

    while len(alive) > limit:
        pairs = [(i, j) for k, i in enumerate(alive) for j in alive[k + 1 :]]
        i, j = min(pairs, key=lambda pair: cost(*pair))
        points = np.concatenate([parts[i][0], parts[j][0]])
        hull = ConvexHull(points)
        parts.append((points[hull.vertices], hull.volume))
        alive = [k for k in alive if k not in (i, j)] + [len(parts) - 1]
    return [parts[k][0] for k in alive]


def slice_into_hulls(vertices: NDArray, faces: NDArray, count: int) -> list[NDArray]:
    """Cut a concave mesh ([V, 3], [F, 3]) across its principal axes; return the hulls of the parts.

    Greedy: each step makes the cut that most reduces the sum of the hull volumes.

    Returns:
        At most `count` arrays of hull vertices [P, 3], which together cover the mesh.
    """
    mean = vertices.mean(axis=0)
    axes = np.linalg.svd(vertices - mean, full_matrices=False)[2]
    triangles = ((vertices - mean) @ axes.T)[faces]
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    boxes = [(low, high)]
    cuts = [_best_cut(triangles, low, high)]
    while len(boxes) < count:
        index = int(np.argmax([gain for gain, _, _ in cuts]))
        gain, axis, level = cuts.pop(index)
        if gain <= 0:
            break
        low, high = boxes.pop(index)
        halves = [(low, _with(high, axis, level)), (_with(low, axis, level), high)]
        boxes += halves
        cuts += [_best_cut(triangles, *half) for half in halves]
    parts = [_in_box(triangles, low, high).reshape(-1, 3) for low, high in boxes]
    return [part[ConvexHull(part).vertices] @ axes + mean for part in parts]


def _best_cut(triangles: NDArray, low: NDArray, high: NDArray) -> tuple[float, int, float]:
    """The cut of a box that most reduces the hull volume: (gain, axis, level)."""
    inside = _in_box(triangles, low, high)
    whole = _hull_volume(inside)
    best = (0.0, 0, 0.0)
    for axis in range(3):
        for level in np.linspace(low[axis], high[axis], 13)[1:-1]:
            halves = [_clip(inside, axis, level, sign) for sign in (1.0, -1.0)]
            gain = whole - sum(_hull_volume(half) for half in halves)
            if min(len(half) for half in halves) >= 4 and gain > best[0]:
                best = (gain, axis, float(level))
    return best


def _in_box(triangles: NDArray, low: NDArray, high: NDArray) -> NDArray:
    """The part of a triangle soup [F, 3, 3] inside a box, as triangles [G, 3, 3]."""
    for axis in range(3):
        for level, sign in ((low[axis], 1.0), (high[axis], -1.0)):
            triangles = _clip(triangles, axis, level, sign)
    return triangles


def _clip(triangles: NDArray, axis: int, level: float, sign: float) -> NDArray:
    """Clip triangles at a plane and triangulate the remainder: [F, 3, 3] -> [G, 3, 3]."""
    side = sign * (triangles[:, :, axis] - level)
    keep = side >= -1e-12
    whole = triangles[keep.all(axis=1)]
    cut = keep.any(axis=1) & ~keep.all(axis=1)
    if not cut.any():
        return whole
    out = [whole]
    for lone in (True, False):  # one corner kept, then one corner cut off
        mine = cut & ((keep.sum(axis=1) == 1) == lone)
        first = np.argmax(keep[mine] == lone, axis=1)
        order = (first[:, None] + np.arange(3)) % 3
        corner = np.take_along_axis(triangles[mine], order[:, :, None], axis=1)
        height = np.take_along_axis(side[mine], order, axis=1)
        a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
        ab = a + (height[:, 0] / (height[:, 0] - height[:, 1]))[:, None] * (b - a)
        ac = a + (height[:, 0] / (height[:, 0] - height[:, 2]))[:, None] * (c - a)
        if lone:
            out.append(np.stack([a, ab, ac], axis=1))
        else:
            out += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(out)


def _hull_volume(triangles: NDArray) -> float:
    points = triangles.reshape(-1, 3)
    if len(points) < 4 or np.ptp(points, axis=0).min() < 1e-9:
        return 0.0
    return float(ConvexHull(points, qhull_options="QJ").volume)


def _with(vector: NDArray, axis: int, value: float) -> NDArray:
    out = vector.copy()
    out[axis] = value
    return out
