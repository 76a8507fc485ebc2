"""From embeddings to masks: mean shift on the unit sphere and clean-up.

Follows unseen object clustering (Xiang et al. 2020): farthest-point seeds, mean shift with a von
Mises-Fisher kernel, merging of nearby modes; the largest cluster is the background. The first seed
is not random but the mean of the table's pixels, so that the masks are deterministic.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sdfgcn.perception.segmenters.config import UCNConfig

_NEIGHBOURS = np.ones((3, 3), dtype=bool)  # 8-connected, so that thin objects stay whole


def cluster(points: NDArray[np.float32], config: UCNConfig) -> NDArray[np.int64]:
    """Cluster unit vectors [P, D] by mean shift with the cosine distance (1 - cos) / 2.

    Most pixels show the table and have nearly the same embedding; they are replaced by one point
    with their total weight, which saves most of the time.

    Returns:
        [P] labels; 0 is the largest cluster.
    """
    commonest = points[np.argmax(points @ points.mean(axis=0))]
    table = points @ commonest >= _cosine(config.table_distance)
    center = points[table].sum(axis=0)
    few = np.vstack([center / np.linalg.norm(center), points[~table]])
    weights = np.ones(len(few), dtype=np.float32)
    weights[0] = table.sum()
    modes = _shifted(few, weights, _farthest_points(few, config), config)
    nearest = np.argmax(few @ _merged(modes, config.merge_distance).T, axis=1)
    labels = np.full(len(points), nearest[0])
    labels[~table] = nearest[1:]
    sizes = np.bincount(labels)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[labels]


def masks_of(labels: NDArray[np.int64], config: UCNConfig) -> NDArray[np.bool_]:
    """Turn clusters [H, W] into masks: one per part of each cluster except the background, 0.

    Separate objects with the same embedding become separate masks, while parts across small gaps,
    as in broken pictures of thin objects, stay together.

    Returns:
        [m, H, W] disjoint masks, largest first; m may be 0.
    """
    masks = []
    for label in range(1, int(labels.max(initial=0)) + 1):
        parts = _parts(labels == label, config.part_gap)
        sizes = np.bincount(parts.ravel())
        large = np.flatnonzero(sizes[1:] >= config.min_pixels) + 1
        masks += [parts == k for k in large]
    taken = np.any(masks, axis=0) if masks else np.zeros(labels.shape, dtype=bool)
    masks.sort(key=lambda mask: -mask.sum())
    for k, mask in enumerate(masks):
        filled = mask | (_holes(mask, config.max_hole) & ~taken)
        taken |= filled
        masks[k] = filled
    masks.sort(key=lambda mask: -mask.sum())
    return np.stack(masks) if masks else np.zeros((0, *labels.shape), dtype=bool)


def _cosine(distance: float) -> float:
    return 1.0 - 2.0 * distance


def _farthest_points(points: NDArray[np.float32], config: UCNConfig) -> NDArray[np.float32]:
    """[S, D] seeds: the first point, then repeatedly the one farthest from all seeds so far."""
    seeds = [points[0]]
    nearest = points @ seeds[0]  # cosine to the nearest seed
    while len(seeds) < config.seeds:
        farthest = int(np.argmin(nearest))
        if nearest[farthest] > _cosine(config.seed_distance):
            break
        seeds.append(points[farthest])
        np.maximum(nearest, points @ seeds[-1], out=nearest)
    return np.stack(seeds)


def _shifted(
    points: NDArray[np.float32],
    weights: NDArray[np.float32],
    modes: NDArray[np.float32],
    config: UCNConfig,
) -> NDArray[np.float32]:
    """[S, D] modes after mean shift; each step moves to the kernel-weighted mean direction."""
    for _ in range(config.iterations):
        # exp(k (cos - 1)) equals exp(k cos) up to a factor that normalisation removes.
        kernel = np.exp(config.concentration * (modes @ points.T - 1.0))
        modes = (kernel * weights) @ points
        modes /= np.linalg.norm(modes, axis=1, keepdims=True)
    return modes


def _merged(modes: NDArray[np.float32], distance: float) -> NDArray[np.float32]:
    """[K, D] modes, without those within `distance` of an earlier one."""
    near = modes @ modes.T >= _cosine(distance)
    kept: list[int] = []
    for k in range(len(modes)):
        if not near[k, kept].any():
            kept.append(k)
    return modes[kept]


def _parts(members: NDArray[np.bool_], gap: int) -> NDArray[np.int64]:
    """[H, W] the part to which each pixel of a cluster belongs, from 1; 0 elsewhere.

    Two pixels belong to the same part if a path with gaps of at most `gap` pixels joins them.
    Dilation by half of that from both sides closes such gaps.
    """
    reach = (gap + 1) // 2
    grown = ndimage.binary_dilation(members, _NEIGHBOURS, iterations=reach) if reach else members
    parts, _ = ndimage.label(grown, structure=_NEIGHBOURS)
    return parts * members


def _holes(mask: NDArray[np.bool_], largest: int | None) -> NDArray[np.bool_]:
    """[H, W] pixels in the holes of a mask, up to `largest` pixels per hole."""
    holes = np.zeros_like(mask)
    (box,) = ndimage.find_objects(mask.astype(np.int8))
    inside = ndimage.binary_fill_holes(mask[box]) & ~mask[box]
    if largest is not None and inside.any():
        parts, _ = ndimage.label(inside)
        small = np.bincount(parts.ravel()) <= largest
        small[0] = False
        inside = small[parts]
    holes[box] = inside
    return holes
