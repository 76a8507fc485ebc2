"""The interface between an env and its world: a simulation, or a real robot and table.

The package comes with `sdfgcn.sim.world.MujocoWorld`. An env resets the world to an episode, looks
at the goal and at the table, and has pushes executed. Ground truth (true masks and poses), which
only a simulation knows, is optional: without it, reward, success and results are computed from
detected centres.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from sdfgcn.task.camera import CameraModel

if TYPE_CHECKING:
    from sdfgcn.objects.model import ObjectModel

PushStatus = Literal["done", "blocked", "unreachable", "no_contact"]
Phase = Literal["descent", "push", "lift", "settle"]


@dataclass(frozen=True)
class PushCommand:
    """A push planned from a picture (paper section IV c).

    Attributes:
        start: [2] where the tool comes down, metres, world frame; NaN if there is no such push.
        angle: Heading of the push, radians counter-clockwise from the world's x axis.
        free: Distance from the start to the first surface in the picture, metres.
    """

    start: NDArray[np.float64]
    angle: float
    free: float


@dataclass(frozen=True)
class RobotLink:
    """One rigid part of a robot, as a mesh in the link's frame.

    Attributes:
        name: The link's name, unique in the robot.
        vertices: float32 [V, 3] metres.
        faces: int32 [F, 3] vertex indices.
        colors: uint8 [V, 3] RGB of each vertex.
    """

    name: str
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    colors: NDArray[np.uint8]


@dataclass(frozen=True)
class RobotShape:
    """What a robot looks like.

    Attributes:
        links: Its L links.
        home: float64 [L, 7] their poses between pushes: xyz in metres, quaternion w, x, y, z.
    """

    links: tuple[RobotLink, ...]
    home: NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """The course of one push, at T moments in their order; T is 0 if the robot did not move.

    Attributes:
        phases: [T] what the robot did; while objects settle, it is at home.
        joints: float64 [T, J] positions of its drives, radians or metres.
        links: float64 [T, L, 7] poses of the robot's links, in the order of its shape.
        objects: float64 [T, n, 7] poses of the objects, by slot.
    """

    phases: tuple[Phase, ...]
    joints: NDArray[np.float64]
    links: NDArray[np.float64]
    objects: NDArray[np.float64]


@dataclass(frozen=True)
class PushResult:
    """The outcome of a push.

    Attributes:
        status: "done"; "blocked" if the descent touched something and was aborted;
            "unreachable" if the robot cannot reach the push; "no_contact" if the push ran but
            touched no object.
        start: [3] where the fingertips started to push, metres, world frame.
        end: [3] where they stopped, metres, world frame.
        motion: The course of the push; None unless a `WatchedWorld` was asked for it.
    """

    status: PushStatus
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    motion: Motion | None = None


class View(Protocol):
    """One moment seen by the camera; each method renders or takes its picture when called."""

    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] the RGB picture."""

    def true_masks(self) -> NDArray[np.bool_]:
        """[n, H, W] one mask per object, all false for a hidden one.

        Raises:
            SdfgcnError: The world does not know the true masks.
        """


@dataclass(frozen=True)
class Truth:
    """Ground truth of an episode, which only a simulation knows, by slot (n objects).

    Attributes:
        objects: The objects.
        colors: float [n, 4] RGBA, 0 to 1; ignored for textured objects.
        goal_poses: float64 [n, 7] goal of each object: xyz in metres, quaternion w, x, y, z.
    """

    objects: tuple[ObjectModel, ...]
    colors: NDArray[np.float64]
    goal_poses: NDArray[np.float64]


class World(Protocol):
    """A table with objects, a camera above it and a robot that pushes.

    Attributes:
        camera: The camera that takes every picture.
        truth: Ground truth of the current episode; None in a real world.
    """

    camera: CameraModel
    truth: Truth | None

    @property
    def n_objects(self) -> int:
        """The number of objects in the current episode."""

    def reset(self, seed: int, n_objects: int) -> None:
        """Start the episode that `seed` determines, with the objects at their start.

        Raises:
            SdfgcnError: There is no such episode.
        """

    def look_at_goal(self) -> View:
        """A view of the episode's goal."""

    def look(self) -> View:
        """A view of the table now."""

    def execute(self, command: PushCommand) -> PushResult:
        """Push, and wait until everything is at rest."""

    def poses(self) -> NDArray[np.float64] | None:
        """float64 [n, 7] the objects' true poses; None in a world without ground truth."""

    def save_state(self) -> dict[str, Any]:
        """The state that the rest of the episode depends on, in JSON types.

        Raises:
            SdfgcnError: The world cannot be restored; no real one can.
        """

    def restore_state(self, state: dict[str, Any]) -> None:
        """Restore a saved state, which may come from another world with the same config."""

    def close(self) -> None:
        """Release the world's resources."""


@runtime_checkable
class Foreseeing(Protocol):
    """A world that can try a push and take it back, which no real one can."""

    def foresee(self, command: PushCommand) -> NDArray[np.float64]:
        """float64 [n, 7] the objects' true poses after a push; the world stays as it is."""


@runtime_checkable
class WatchedWorld(Protocol):
    """A world that also knows where its robot and its objects are during a push; optional.

    Attributes:
        watching: Whether `execute` also returns the motion of each push; may be set. It changes no
            outcome.
    """

    watching: bool

    def robot_shape(self) -> RobotShape | None:
        """What the robot looks like; None if there is no model of that."""
