"""How far the objects are from their goals; the reward is computed from this.

True poses are used where the world knows them, detected centres otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from sdfgcn.task.region import Region
from sdfgcn.task.scene import Scene


@dataclass(frozen=True)
class Standing:
    """The state of an episode relative to its goal.

    Attributes:
        distances: float64 [k] horizontal distance of each object to its goal, metres: by slot with
            true poses, else by row, NaN for an unmatched row.
        success: Every object is within the threshold of its goal.
        out_of_range: Some object's centre is outside the allowed region.
    """

    distances: NDArray[np.float64]
    success: bool
    out_of_range: bool


def true_standing(
    poses: NDArray[np.float64], goal_poses: NDArray[np.float64], threshold: float, allowed: Region
) -> Standing:
    """The standing by true centres.

    Args:
        poses: [n, 7] current poses: xyz in metres and a quaternion.
        goal_poses: [n, 7] goal poses, in the same format.
        threshold: Distance at which an object is at its goal, metres.
        allowed: Where an object may be.
    """
    distances = np.linalg.norm(poses[:, :2] - goal_poses[:, :2], axis=1)
    return Standing(
        distances,
        success=bool((distances <= threshold).all()),
        out_of_range=not allowed.contains(poses[:, :2]).all(),
    )


def seen_standing(
    scene: Scene, goal: Scene, matched: NDArray[np.bool_], threshold: float, allowed: Region
) -> Standing:
    """The standing by detected centres; an unmatched goal object counts as not at its goal.

    Args:
        scene: The current scene.
        goal: The goal's scene.
        matched: bool [N] the rows in which both show the same object.
        threshold: Distance at which an object is at its goal, metres.
        allowed: Where an object may be.
    """
    centers = scene.center.double().numpy()
    offsets = centers - goal.center.double().numpy()
    distances = np.where(matched, np.linalg.norm(offsets, axis=1), np.nan)
    wanted = goal.node_mask.numpy()
    return Standing(
        distances,
        success=bool(wanted.any() and (distances[wanted] <= threshold).all()),
        out_of_range=not allowed.contains(centers[scene.node_mask.numpy()]).all(),
    )


def nearest_objects(center: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Assign true centres to detections.

    Args:
        center: [m, 2] detected centres, metres.
        true: [n, 2] the objects' true centres, metres.

    Returns:
        [m, 2] for each detection, the true centre of a distinct object, at least total distance; a
        surplus detection keeps its own centre.
    """
    position = center.copy()
    distances = np.linalg.norm(center[:, None] - true[None], axis=-1)
    detections, objects = linear_sum_assignment(distances)
    position[detections] = true[objects]
    return position
