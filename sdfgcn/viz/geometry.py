"""Geometry that drawing needs: outlines, normals, and which mask shows which object."""

from __future__ import annotations

import contourpy
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from sdfgcn.envs.types import Scene
from sdfgcn.geometry.camera import CameraModel

_FAR = 1e6  # a cost that loses against any real one


def zero_contour(sdf: NDArray[np.floating]) -> list[NDArray[np.float64]]:
    """Where a signed distance field crosses zero.

    Args:
        sdf: [H, W] signed distances, sampled at pixel centres.

    Returns:
        Polylines [P, 2] of column u and row v in the pixel coordinates of `CameraModel`.
    """
    centres_u = np.arange(sdf.shape[1]) + 0.5
    centres_v = np.arange(sdf.shape[0]) + 0.5
    generator = contourpy.contour_generator(
        centres_u, centres_v, sdf, line_type=contourpy.LineType.Separate
    )
    return [np.asarray(line) for line in generator.lines(0.0)]


def vertex_normals(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> NDArray[np.float32]:
    """Normals for smooth shading, each face weighted by its area.

    Args:
        vertices: [V, 3].
        faces: [F, 3], counter-clockwise from outside.

    Returns:
        [V, 3] unit vectors; zero for a vertex of no face.
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    of_faces = np.cross(b - a, c - a)
    sums = np.zeros_like(vertices, dtype=np.float64)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], of_faces)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=sums, where=lengths > 0.0).astype(np.float32)


def node_slots(scene: Scene, radii: NDArray[np.float64], camera: CameraModel) -> NDArray[np.intp]:
    """Which object each node shows, by the true poses; for drawing only.

    Nodes come in any order and number; a slot stays the same all episode, so colours and names
    go by slot. A node pairs with the object whose centre projects nearest to the centre of its
    mask (optimal assignment), unless they are further apart than the object is large.

    Args:
        scene: The picture's m nodes and n poses.
        radii: [n] largest distance of any vertex from the object's origin, metres.
        camera: The camera that took the picture.

    Returns:
        [m] slot of each node, -1 for a node that shows none of the objects.
    """
    centres = np.array([_mask_centre(mask) for mask in scene.masks]).reshape(-1, 2)
    positions = scene.poses[:, :3]
    sizes = camera.focal * radii / np.linalg.norm(positions - camera.position, axis=1)
    gaps = np.linalg.norm(centres[:, None] - camera.project(positions)[None], axis=-1) / sizes
    costs = np.nan_to_num(gaps, nan=_FAR)
    slots = np.full(len(scene.masks), -1)
    for node, slot in zip(*linear_sum_assignment(costs), strict=True):
        if costs[node, slot] <= 1.0:
            slots[node] = slot
    return slots


def edge_strips(
    masks: NDArray[np.bool_], goal_masks: NDArray[np.bool_], matched: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The scene graph's edges at the current nodes, as lines in the picture.

    Args:
        masks: [N, H, W] the current scene's; an empty one is no node.
        goal_masks: [N, H, W] the goal's.
        matched: [N] the rows in which both show the same object.

    Returns:
        [E, 2, 2] the ends of each edge: column and row of the centres of the nodes' masks,
        pixels; and [E] whether the edge leads to the goal's node.
    """
    seen, goal_seen = masks.any(axis=(1, 2)), goal_masks.any(axis=(1, 2))
    among = np.triu(np.outer(seen, seen), k=1)
    ends = np.argwhere(np.hstack([among, np.diag(matched & seen & goal_seen)]))
    centres = np.array([_mask_centre(mask) for mask in (*masks, *goal_masks)])
    return centres.reshape(-1, 2)[ends], ends[:, 1] >= len(masks)


def _mask_centre(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return np.full(2, np.nan)
    return np.array([columns.mean() + 0.5, rows.mean() + 0.5])
