"""The rule-based agent (paper section VI B)."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase

from sdfgcn.config import N_DIRECTIONS, Config
from sdfgcn.registry import MODELS

TURN = 2 * np.pi / N_DIRECTIONS


@MODELS.register("rule_based")
class RuleBasedAgent:
    """Pushes a random object that has not reached its goal in the nearest direction towards it.

    Under `perception=oracle` it knows which object belongs to which goal and where both truly
    lie, as in the paper; under any other it goes by the matched detections and their centres.
    Where the mask forbids that push, it takes the next nearest direction, then another object.
    """

    def __init__(self, config: Config, rng: np.random.Generator) -> None:
        self._threshold = config.env.success_threshold
        self._where = "position" if config.env.perception.name == "oracle" else "center"
        self._rng = rng

    def __call__(self, td: TensorDictBase) -> TensorDictBase:
        """Set `action`.

        Args:
            td: One environment's observation, without batch dimension: `position` and
                `goal_position` (or `center` and `goal_center`) float [N, 2] in metres,
                `correspondence` int64 [N], `node_mask` bool [N], `action_mask` bool [N * 8].

        Returns:
            The same TensorDict with `action` int64 [], object * 8 + direction.

        Raises:
            ValueError: The mask allows no action at all.
        """
        match = td["correspondence"].numpy()
        goal, current = td[f"goal_{self._where}"].double(), td[self._where].double()
        offsets = goal.numpy()[match] - current.numpy()
        legal = td["action_mask"].numpy().reshape(-1, N_DIRECTIONS)
        obj, direction = self._choose(offsets, td["node_mask"].numpy() & (match >= 0), legal)
        td["action"] = torch.tensor(obj * N_DIRECTIONS + direction, dtype=torch.int64)
        return td

    def _choose(
        self, offsets: NDArray[np.float64], nodes: NDArray[np.bool_], legal: NDArray[np.bool_]
    ) -> tuple[int, int]:
        away = nodes & (np.linalg.norm(offsets, axis=1) > self._threshold)
        movable = legal.any(axis=1)
        for candidates in (away & movable, movable):
            if candidates.any():
                obj = int(self._rng.choice(np.flatnonzero(candidates)))
                ranked = nearest_directions(offsets[obj])
                return obj, int(ranked[legal[obj, ranked]][0])
        raise ValueError("action_mask allows no action.")


def nearest_directions(offset: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rank the push directions by their angle to an offset, nearest first.

    Args:
        offset: [2] metres, world x and y.

    Returns:
        [8] directions; direction k heads k * 45 degrees counter-clockwise from the x axis.
    """
    angle = np.arctan2(offset[1], offset[0])
    gap = (np.arange(N_DIRECTIONS) * TURN - angle + np.pi) % (2 * np.pi) - np.pi
    return np.argsort(np.abs(gap), kind="stable")
