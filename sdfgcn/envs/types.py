"""What an environment reports about an episode besides its TensorDict.

Recorders and result tables read these. A *node* is one detected object; its index is the row of
its mask. Shapes: m detected objects (nodes), n objects in the episode, N nodes after padding.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sdfgcn.geometry.camera import CameraModel
from sdfgcn.sim.types import Push

if TYPE_CHECKING:
    from sdfgcn.objects.model import ObjectModel


@dataclass(frozen=True)
class Scene:
    """What one picture shows, and where the objects truly lie.

    Attributes:
        pixels: uint8 [H, W, 3] the RGB picture; None when the environment does not render it.
        masks: bool [m, H, W] one mask per node.
        sdf: float32 [m, H, W] signed distance to the mask's edge, pixels, negative inside.
        poses: float64 [n, 7] true poses in slot order: xyz in metres, quaternion w, x, y, z.
        correspondence: int64 [m] for each node the goal's node it is matched with, -1 for none;
            None for the goal itself.
    """

    pixels: NDArray[np.uint8] | None
    masks: NDArray[np.bool_]
    sdf: NDArray[np.float32]
    poses: NDArray[np.float64]
    correspondence: NDArray[np.int64] | None = None


@dataclass(frozen=True)
class EpisodeStart:
    """What is fixed for one episode, and its first scene.

    Attributes:
        seed: The episode's seed.
        objects: The n objects in slot order.
        colors: float [n, 4] RGBA in 0..1 in slot order; a textured object ignores it.
        scene: The start.
        goal: The arrangement to reach.
        camera: The camera that took both pictures.
    """

    seed: int
    objects: tuple[ObjectModel, ...]
    colors: NDArray[np.float64]
    scene: Scene
    goal: Scene
    camera: CameraModel


@dataclass(frozen=True)
class StepRecord:
    """One push and what came of it.

    Attributes:
        index: 1 for the first push of the episode.
        push: What was executed.
        scene: The scene after the push.
        distances: float [n] distance of each object to its goal after the push, metres.
        reward_terms: The reward's terms by name.
        reward: Their sum, as the agent gets it.
        success: Every object lies within the threshold of its goal.
        out_of_range: An object left the allowed region.
        terminated: The episode ended by success or out of range.
        truncated: The episode ended at the step limit.
        q_values: float [N, 8] the agent's action values, if it has any.
        legal: bool [N, 8] which actions were legal; None: not known.
    """

    index: int
    push: Push
    scene: Scene
    distances: NDArray[np.float64]
    reward_terms: dict[str, float]
    reward: float
    success: bool
    out_of_range: bool
    terminated: bool
    truncated: bool
    q_values: NDArray[np.float32] | None
    legal: NDArray[np.bool_] | None = None
