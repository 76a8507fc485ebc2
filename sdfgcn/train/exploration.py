"""The policy of training: epsilon-greedy with a falling epsilon."""

from __future__ import annotations

import copy
from typing import Any

from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.data import Categorical
from torchrl.modules import EGreedyModule

from sdfgcn.config import TrainConfig
from sdfgcn.train.learner import q_actor


class EpsilonGreedyPolicy:
    """An epsilon-greedy policy over a CPU copy of the learner's network.

    Attributes:
        module: Sets `action`; the policy for collectors.
    """

    def __init__(
        self,
        network: TensorDictModuleBase,
        actions: Categorical,
        train: TrainConfig,
        epsilon_pushes: int,
    ) -> None:
        """Copy the network.

        Args:
            network: The learner's network.
            actions: The action spec.
            train: Holds the first and last epsilon.
            epsilon_pushes: Pushes over which epsilon falls.
        """
        self._network = copy.deepcopy(network).cpu().requires_grad_(False)
        self._greedy = EGreedyModule(
            spec=actions.clone(),
            eps_init=train.epsilon_start,
            eps_end=train.epsilon_end,
            annealing_num_steps=epsilon_pushes,
            action_mask_key="action_mask",
        )
        self.module = TensorDictSequential(q_actor(self._network, actions.clone()), self._greedy)

    @property
    def epsilon(self) -> float:
        """The current share of random pushes."""
        return float(self._greedy.eps)

    def load_weights(self, network: TensorDictModuleBase) -> None:
        """Copy the learner's weights."""
        self._network.load_state_dict(network.state_dict())

    def pushed(self, pushes: int) -> None:
        """Advance the epsilon schedule by `pushes` pushes."""
        self._greedy.step(pushes)

    def state_dict(self) -> dict[str, Any]:
        """Epsilon, for a checkpoint; the learner saves the weights."""
        return {"epsilon": self.epsilon}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore epsilon from a checkpoint."""
        self._greedy.eps.fill_(float(state["epsilon"]))
