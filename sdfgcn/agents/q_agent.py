"""The agent of a trained Q-network: mostly greedy (paper section III A)."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase


class QAgent:
    """Takes the legal push of the highest value, or now and then a random one.

    It can refuse to be caught in a loop: a push that was tried in the same state of the episode
    led back to it, so the next best is taken. When all have been tried, all are allowed again.
    """

    def __init__(
        self,
        network: TensorDictModuleBase,
        rng: np.random.Generator,
        epsilon: float,
        loop_distance: float | None,
    ) -> None:
        """Make the agent.

        Args:
            network: Sets `action_value` float [N * 8] from an observation.
            rng: Where random pushes are drawn from.
            epsilon: Their share.
            loop_distance: Two states count as the same where no object's detected centre is
                further apart, metres; None: states are not compared.
        """
        self._network = network
        self._rng = rng
        self._epsilon = epsilon
        self._loop_distance = loop_distance
        self._tried: list[tuple[NDArray[np.float32], int]] = []  # in this episode

    def __call__(self, td: TensorDictBase) -> TensorDictBase:
        """Set `action` and `action_value`.

        Args:
            td: One environment's observation, without batch dimension.

        Returns:
            The same TensorDict with `action` int64 [], object * 8 + direction, and
            `action_value` float32 [N * 8].

        Raises:
            ValueError: The mask allows no action at all.
        """
        with torch.no_grad():
            values = self._network(td.copy())["action_value"].float()
        td["action_value"] = values
        legal = np.flatnonzero(td["action_mask"].numpy())
        if len(legal) == 0:
            raise ValueError("action_mask allows no action.")
        if int(td["pushes"]) == 0:
            self._tried.clear()
        centers = td["center"].numpy().copy()
        if self._rng.random() < self._epsilon:
            action = int(self._rng.choice(legal))
        else:
            candidates = self._untried(legal, centers)
            action = int(candidates[np.argmax(values.numpy()[candidates])])
        self._tried.append((centers, action))
        td["action"] = torch.tensor(action, dtype=torch.int64)
        return td

    def _untried(self, legal: NDArray[np.int64], centers: NDArray[np.float32]) -> NDArray[np.int64]:
        if self._loop_distance is None:
            return legal
        same = [
            action
            for before, action in self._tried
            if np.linalg.norm(before - centers, axis=-1).max() <= self._loop_distance
        ]
        untried = legal[~np.isin(legal, same)]
        return untried if len(untried) else legal
