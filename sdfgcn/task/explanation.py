"""What an agent expected of the push that it chose; optional, for recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Explanation:
    """An agent's expectations, by row of the scene in which it chose (N rows, D directions).

    Attributes:
        displacement: float32 [N, 2] predicted displacement of every object by the chosen push,
            metres; 0 for rows without an object.
        deviation: float32 [N] standard deviation of each coordinate of it, metres.
        scores: float32 [N, D] for each name: what the agent weighed of each push; NaN where it did
            not weigh the push.
    """

    displacement: NDArray[np.float32]
    deviation: NDArray[np.float32]
    scores: dict[str, NDArray[np.float32]]
