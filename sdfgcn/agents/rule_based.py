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
    """Pushes a random object that is not at its goal in the direction nearest to its goal.

    With `perception=oracle` it uses the true positions of objects and goals, as in the paper;
    otherwise the centres of matched detections.
    """

    def __init__(self, config: Config, rng: np.random.Generator) -> None:
        """Read the rule's numbers; `rng` draws the object."""
        self._threshold = config.env.success_threshold
        self._where = "position" if config.env.perception.name == "oracle" else "center"
        self._pushes = PushSpace(config.env.push, config.env.arena)
        self._rng = rng

    def __call__(self, td: TensorDictBase) -> Tensor:
        """Rank the pushes: first the drawn object's, then the others'.

        The object is drawn from those away from their goals that have a legal push, or else from
        all that have one. The others that are away follow, then the rest, by row. The pushes of
        each object are ranked by their angle to its goal.

        Args:
            td: The observation of one env, without batch dimension, with a legal push.

        Returns:
            float32 [N * D], higher is better.
        """
        matched = (td["matched"] & td["scene", "node_mask"]).numpy()
        goal, current = (td[part, self._where].double().numpy() for part in ("goal", "scene"))
        offsets = np.where(matched[:, None], goal, 0.0) - current  # without a goal: to the origin
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
