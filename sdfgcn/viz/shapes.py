"""Geometry for drawing: outlines, normals, edges, moves, and which row shows which object."""

from __future__ import annotations

import itertools

import contourpy
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from sdfgcn.envs.records import Snapshot
from sdfgcn.objects.model import ObjectModel
from sdfgcn.task.camera import CameraModel
from sdfgcn.task.world import Motion

_FAR = 1e6  # a cost above any real one


def zero_contour(sdf: NDArray[np.floating]) -> list[NDArray[np.float64]]:
    """The zero contour of a signed distance field [H, W] sampled at pixel centres.

    Returns:
        Polylines [P, 2] of (u, v) in the pixel coordinates of `CameraModel`.
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
    """[V, 3] area-weighted unit normals for smooth shading of a mesh."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    of_faces = np.cross(b - a, c - a)
    sums = np.zeros_like(vertices, dtype=np.float64)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], of_faces)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, lengths, out=sums, where=lengths > 0.0).astype(np.float32)


def row_slots(
    moment: Snapshot, radii: NDArray[np.float64], camera: CameraModel
) -> NDArray[np.intp]:
    """The object that each row shows, from the true poses; for drawing only.

    Slots are fixed for an episode, so colours and names go by slot. Each row is assigned the object
    whose projected centre is nearest to the centre of its mask (optimal assignment), unless they
    are further apart than the object's radius. Without true poses, row i stands for slot i.

    Args:
        moment: The scene's N rows and n poses.
        radii: [n] largest distance of any vertex from the object's origin, metres; without true
            poses, only their number matters.
        camera: The camera that took the picture.

    Returns:
        [N] slot of each row, -1 for a row that shows no object.
    """
    rows = np.flatnonzero(moment.scene.node_mask.numpy())
    slots = np.full(len(moment.scene.node_mask), -1)
    if moment.poses is None:
        slots[rows] = np.where(rows < len(radii), rows, -1)
        return slots
    masks = moment.scene.masks.numpy()
    centres = np.array([mask_centre(masks[row]) for row in rows]).reshape(-1, 2)
    positions = moment.poses[:, :3]
    sizes = camera.focal * radii / np.linalg.norm(positions - camera.position, axis=1)
    gaps = np.linalg.norm(centres[:, None] - camera.project(positions)[None], axis=-1) / sizes
    costs = np.nan_to_num(gaps, nan=_FAR)
    for node, slot in zip(*linear_sum_assignment(costs), strict=True):
        if costs[node, slot] <= 1.0:
            slots[rows[node]] = slot
    return slots


def edge_strips(moment: Snapshot, goal: Snapshot) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The scene graph's edges at the current nodes, as lines in the picture.

    Returns:
        [E, 2, 2] the ends of each edge: (u, v) of mask centres, pixels; and [E] whether the edge
        leads to a goal node.
    """
    seen, matched = moment.scene.node_mask.numpy(), np.flatnonzero(moment.matched)
    here, there = moment.scene.masks.numpy(), goal.scene.masks.numpy()
    pairs = list(itertools.combinations(np.flatnonzero(seen), 2))
    strips = [(mask_centre(here[i]), mask_centre(here[j])) for i, j in pairs]
    strips += [(mask_centre(here[i]), mask_centre(there[i])) for i in matched]
    to_goal = np.arange(len(strips)) >= len(pairs)
    return np.array(strips).reshape(-1, 2, 2), to_goal


def displacements(
    before: Snapshot, after: Snapshot, slots: NDArray[np.intp]
) -> NDArray[np.float64]:
    """[N, 2] how far the object of each row moved on the table, metres; NaN where unknown.

    `slots` [N] are those of the rows before (see `row_slots`). Without true poses, it is how far
    the detected centres moved.
    """
    moved = np.full((len(slots), 2), np.nan)
    if before.poses is not None and after.poses is not None:
        known = slots >= 0
        moved[known] = (after.poses - before.poses)[slots[known], :2]
        return moved
    both = before.scene.node_mask.numpy() & after.scene.node_mask.numpy()
    moved[both] = (after.scene.center - before.scene.center).numpy()[both]
    return moved


def goal_distances(now: Snapshot, goal: Snapshot) -> NDArray[np.float64]:
    """[k] distance of each object to its goal, metres: as `Standing.distances`."""
    if now.poses is not None and goal.poses is not None:
        return np.linalg.norm((now.poses - goal.poses)[:, :2], axis=1)
    distances = np.linalg.norm((now.scene.center - goal.scene.center).double().numpy(), axis=1)
    return np.where(now.matched, distances, np.nan)


def top(model: ObjectModel, pose: NDArray[np.float64]) -> float:
    """Height of an object's highest point at a pose [7], metres."""
    turned = Rotation.from_quat(pose[3:], scalar_first=True).apply(model.vertices)
    return float(pose[2] + turned[:, 2].max())


def circle(middle: NDArray[np.floating], radius: float) -> NDArray[np.float64]:
    """[25, 2] points of a closed circle."""
    angles = np.linspace(0.0, 2.0 * np.pi, 25)
    return middle + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


def moments_to_draw(motion: Motion) -> NDArray[np.intp]:
    """Which moments of a push are drawn: a few of each phase, its first and last among them."""
    phases = np.array(motion.phases)
    kept: list[int] = []
    for phase, count in (("descent", 2), ("push", 5), ("lift", 2)):
        of_phase = np.flatnonzero(phases == phase)
        if len(of_phase):
            places = np.linspace(0, len(of_phase) - 1, count).round().astype(int)
            kept += of_phase[np.unique(places)].tolist()
    return np.array(kept, dtype=np.intp)


def mask_centre(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(u, v) of the middle of a mask [H, W], pixels; NaN for an empty one."""
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return np.full(2, np.nan)
    return np.array([columns.mean() + 0.5, rows.mean() + 0.5])
