"""The epsilon-greedy choice of a push from any agent's preferences (paper section III A)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from sdfgcn.task.explanation import Explanation

# Called with the observation of one env (no batch dimension); returns float32 [N * D], a preference
# for each push in the order of `PushSpace`'s actions. Only the ranking of legal pushes matters.
# An agent may also have a method `explain`, as `EpsilonGreedy` has.
Agent = Callable[[TensorDictBase], Tensor]


class QAgent:
    """Prefers pushes by their Q-value."""

    def __init__(self, network: TensorDictModuleBase) -> None:
        """Take a network that sets `action_value` [N * D] from an observation."""
        self._network = network

    def __call__(self, td: TensorDictBase) -> Tensor:
        """The action values; see `Agent`."""
        with torch.no_grad():
            return self._network(td.copy())["action_value"].float()

    def explain(self, td: TensorDictBase) -> Explanation | None:
        """What the network expects of `td["action"]`; None for one that predicts values alone."""
        explain = getattr(self._network, "explain", None)
        return None if explain is None else explain(td)


class EpsilonGreedy:
    """Takes the legal push that an agent prefers, or with probability epsilon a random one.

    It can also break loops: a push already tried in the same state of the episode led back to it,
    so the next best is taken. Once all have been tried, all are allowed again.
    """

    def __init__(
        self,
        agent: Agent,
        rng: np.random.Generator,
        epsilon: float,
        loop_distance: float | None,
    ) -> None:
        """Wrap an agent.

        Args:
            agent: Ranks the pushes.
            rng: Generator for random pushes.
            epsilon: Share of random pushes; at 0, nothing is drawn.
            loop_distance: Two states are the same if no object's detected centres are further
                apart than this, metres; None turns loop breaking off.
        """
        self._agent = agent
        self._rng = rng
        self._epsilon = epsilon
        self._loop_distance = loop_distance
        self._tried: list[tuple[NDArray[np.float32], int]] = []  # in this episode

    def attach(self, env: Any) -> None:
        """Give the env to an agent that tries pushes in its world; others do not need it."""
        if hasattr(self._agent, "attach"):
            self._agent.attach(env)

    def __call__(self, td: TensorDictBase) -> TensorDictBase:
        """Pick a push for the observation of one env, without batch dimension.

        Returns:
            The same TensorDict with `action` int64 [] and, if the agent is a Q-network,
            `action_value` float32 [N * D].

        Raises:
            ValueError: The mask allows no action.
        """
        legal = np.flatnonzero(td["action_mask"].numpy())
        if len(legal) == 0:
            raise ValueError("action_mask allows no action.")
        if int(td["pushes"]) == 0:
            self._tried.clear()
        preferences = self._agent(td)
        if isinstance(self._agent, QAgent):
            td["action_value"] = preferences
        centers = td["scene", "center"].numpy().copy()
        if self._epsilon > 0.0 and self._rng.random() < self._epsilon:
            action = int(self._rng.choice(legal))
        else:
            candidates = self._untried(legal, centers)
            action = int(candidates[np.argmax(preferences.numpy()[candidates])])
        self._tried.append((centers, action))
        td["action"] = torch.tensor(action, dtype=torch.int64)
        return td

    def explain(self, td: TensorDictBase) -> Explanation | None:
        """What the agent expects of the push chosen in `td`, for recordings; None if it has no say.

        It draws nothing and changes nothing.
        """
        explain = getattr(self._agent, "explain", None)
        return None if explain is None else explain(td)

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
