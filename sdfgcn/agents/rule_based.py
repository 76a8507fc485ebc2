"""The rule-based agent (paper section VI B)."""

from __future__ import annotations

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from sdfgcn.config import Config
from sdfgcn.registry import MODELS
from sdfgcn.task.push_space import PushSpace


@MODELS.register("rule_based")
class RuleBasedAgent:
    """Prefers to push a random object that is not at its goal in the nearest direction towards it.

    Under `perception=oracle` it knows where the objects and their goals truly lie, as in the
    paper; under any other it goes by the matched detections and their centres.
    """

    def __init__(self, config: Config, rng: np.random.Generator) -> None:
        """Read the rule's numbers, and take the generator that the object is drawn from."""
        self._threshold = config.env.success_threshold
        self._where = "position" if config.env.perception.name == "oracle" else "center"
        self._pushes = PushSpace(config.env.push, config.env.arena)
        self._rng = rng

    def __call__(self, td: TensorDictBase) -> Tensor:
        """Rank the pushes: first the drawn object's, then those of the others.

        The object is drawn among those that are away from their goals and have a legal push, or
        among all that have one. After it come the others that are away, then all others, by row.
        The pushes of each object are ranked by their angle to its goal.

        Args:
            td: One environment's observation, without batch dimension, with a legal push.

        Returns:
            float32 [N * D], higher is better.
        """
        matched = (td["matched"] & td["scene", "node_mask"]).numpy()
        goal, current = (td[part, self._where].double().numpy() for part in ("goal", "scene"))
        offsets = np.where(matched[:, None], goal, 0.0) - current  # without a goal: to the middle
        movable = self._pushes.by_direction(td["action_mask"]).any(dim=-1).numpy()
        away = movable & matched & (np.linalg.norm(offsets, axis=1) > self._threshold)
        drawn = int(self._rng.choice(np.flatnonzero(away if away.any() else movable)))
        rows = dict.fromkeys([drawn, *np.flatnonzero(away).tolist(), *range(len(movable))])
        ranked = [
            self._pushes.encode(row, int(direction))
            for row in rows
            for direction in self._pushes.nearest(offsets[row])
        ]
        preferences = torch.zeros(len(ranked))
        preferences[ranked] = torch.arange(len(ranked), 0, -1, dtype=torch.float32)
        return preferences
