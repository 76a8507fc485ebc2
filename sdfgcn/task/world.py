"""What an environment asks of a world: a simulation, or a real robot above a real table.

`sdfgcn.sim.world.MujocoWorld` is the one that comes with the package. An environment resets a
world to an episode, looks at the goal and at the table, and has pushes executed. What only a
simulation can know (true masks and true poses) is optional: without it, reward, success and
results go by the centres that were seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from sdfgcn.task.camera import CameraModel

if TYPE_CHECKING:
    from sdfgcn.objects.model import ObjectModel

PushStatus = Literal["done", "blocked", "unreachable", "no_contact"]


@dataclass(frozen=True)
class PushCommand:
    """A push that has been planned from a picture (paper section IV c).

    Attributes:
        start: [2] where the tool comes down, metres, world frame; NaN where there is no such push.
        angle: Where the push heads, radians counter-clockwise from the world's x axis.
        free: Distance from the start to the first surface that the picture shows, metres.
    """

    start: NDArray[np.float64]
    angle: float
    free: float


@dataclass(frozen=True)
class PushResult:
    """What became of a push.

    Attributes:
        status: "done"; "blocked" when the descent touched something and was given up;
            "unreachable" when the robot cannot get there; "no_contact" when the push ran but
            touched no object.
        start: [3] where the fingertips began to push, metres, world frame.
        end: [3] where they stopped, metres, world frame.
    """

    status: PushStatus
    start: NDArray[np.float64]
    end: NDArray[np.float64]


class View(Protocol):
    """One moment, as the camera shows it; a picture is taken when it is asked for."""

    def pixels(self) -> NDArray[np.uint8]:
        """[H, W, 3] the RGB picture."""

    def true_masks(self) -> NDArray[np.bool_]:
        """[n, H, W] one mask per object, all false where one is hidden.

        Raises:
            SdfgcnError: The world does not know them.
        """


@dataclass(frozen=True)
class Truth:
    """What only a simulation knows of an episode, in the order of its n objects (its slots).

    Attributes:
        objects: The objects.
        colors: float [n, 4] RGBA, 0 to 1; an object with a texture ignores it.
        goal_poses: float64 [n, 7] where the objects belong: xyz in metres, quaternion w, x, y, z.
    """

    objects: tuple[ObjectModel, ...]
    colors: NDArray[np.float64]
    goal_poses: NDArray[np.float64]


class World(Protocol):
    """A table with objects, a camera above it and a robot that pushes.

    Attributes:
        camera: Takes every picture.
        truth: What is known of the running episode besides pictures; None in a real world.
    """

    camera: CameraModel
    truth: Truth | None

    @property
    def n_objects(self) -> int:
        """Objects of the running episode."""

    def reset(self, seed: int, n_objects: int) -> None:
        """Begin the episode that the seed stands for, with the objects at its start.

        Raises:
            SdfgcnError: There is no such episode.
        """

    def look_at_goal(self) -> View:
        """The goal of the episode."""

    def look(self) -> View:
        """The table as it is."""

    def execute(self, command: PushCommand) -> PushResult:
        """Push, and wait until everything lies still."""

    def poses(self) -> NDArray[np.float64] | None:
        """float64 [n, 7] the objects' true poses; None if the world has no truth."""

    def save_state(self) -> dict[str, Any]:
        """All that the rest of the episode depends on, as JSON knows it.

        Raises:
            SdfgcnError: The world cannot go back, as no real one can.
        """

    def restore_state(self, state: dict[str, Any]) -> None:
        """Go back to a saved state, also one of another world with the same config."""

    def close(self) -> None:
        """Free what the world holds."""
