"""Records of an episode that an env keeps besides its observations.

Recorders and result tables read them. Shapes: n objects in the episode (slots, in the order of
the truth), N rows of a scene, D push directions, H and W the picture's size.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdfgcn.task.camera import CameraModel
from sdfgcn.task.explanation import Explanation
from sdfgcn.task.scene import Scene
from sdfgcn.task.world import PushResult, RobotShape, Truth


@dataclass(frozen=True)
class Snapshot:
    """One moment of an episode.

    Attributes:
        scene: The output of perception.
        matched: bool [N] the rows in which the scene and the goal show the same object; for the
            goal itself, its detected rows.
        pixels: uint8 [H, W, 3] the RGB picture; None unless the env records or observes pixels.
        poses: float64 [n, 7] true poses by slot: xyz in metres, quaternion w, x, y, z; None in a
            world without truth.
    """

    scene: Scene
    matched: NDArray[np.bool_]
    pixels: NDArray[np.uint8] | None
    poses: NDArray[np.float64] | None


@dataclass(frozen=True)
class EpisodeStart:
    """The constants of an episode and its first moment.

    Attributes:
        seed: The episode's seed.
        n_objects: Objects in the episode.
        truth: The objects, their colours and true goals; None in a world without truth.
        start: The first moment.
        goal: The arrangement to reach.
        camera: The camera that took both pictures.
        robot: What the robot looks like; None unless the env records and the world knows.
    """

    seed: int
    n_objects: int
    truth: Truth | None
    start: Snapshot
    goal: Snapshot
    camera: CameraModel
    robot: RobotShape | None = None


@dataclass(frozen=True)
class Push:
    """The push that an action encodes, and its outcome.

    Attributes:
        row: The pushed row, in the scene before the push.
        direction: Index of the direction, 0 to D - 1.
        angle: Heading of the direction, radians counter-clockwise from the world's x axis.
        result: Status, start and end.
    """

    row: int
    direction: int
    angle: float
    result: PushResult


@dataclass(frozen=True)
class StepRecord:
    """One step of an episode.

    Attributes:
        index: 1 for the first push of the episode.
        push: The push that was executed.
        after: The moment after the push.
        distances: float64 [k] distance of each object to its goal after the push, metres; as in
            `Standing`.
        reward_terms: The reward's terms by name.
        reward: Their sum, which the agent receives.
        success: Every object lies within the threshold of its goal.
        out_of_range: An object left the allowed region.
        terminated: The episode ended in success, out of range, or with no object detected.
        truncated: The episode ended at the step limit.
        legal: bool [N, D] the pushes that were legal.
        q_values: float [N, D] the agent's action values, if it has any.
        explanation: What the agent expected of the push, if it says and the episode is recorded.
    """

    index: int
    push: Push
    after: Snapshot
    distances: NDArray[np.float64]
    reward_terms: dict[str, float]
    reward: float
    success: bool
    out_of_range: bool
    terminated: bool
    truncated: bool
    legal: NDArray[np.bool_]
    q_values: NDArray[np.float32] | None = None
    explanation: Explanation | None = None
