"""What the simulation hands upwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

PushStatus = Literal["done", "blocked", "unreachable", "no_contact"]


@dataclass(frozen=True)
class Push:
    """One executed (or given up) push primitive (paper section IV c).

    Attributes:
        object: The node that was pushed: its index in the masks of the scene before the push.
        direction: Which of the 8 directions: the push heads `direction` * 45 degrees
            counter-clockwise from the world's x axis.
        start: [3] where the fingertip starts to push, metres, world frame.
        end: [3] where the fingertip stops, metres, world frame.
        status: "done"; "blocked" when the descent touched something and was given up;
            "unreachable" when the robot cannot get there; "no_contact" when the push ran but
            touched no object.
    """

    object: int
    direction: int
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    status: PushStatus


@dataclass(frozen=True)
class PushCommand:
    """A push that has been planned from the picture (`sdfgcn.perception.push_start`).

    Attributes:
        start: [2] where the tool comes down, metres, world frame.
        direction: Which of the 8 directions.
        free: Distance from the start to the first surface that the picture shows, metres.
    """

    start: NDArray[np.float64]
    direction: int
    free: float
