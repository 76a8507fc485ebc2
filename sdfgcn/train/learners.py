"""What trains a network: one learner for each kind of network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from tensordict import TensorDictBase
from torchrl.data import Categorical

from sdfgcn.config import TrainConfig
from sdfgcn.models.q_network import QNetwork
from sdfgcn.train.displacement import DisplacementLearner
from sdfgcn.train.learner import Learner


class AnyLearner(Protocol):
    """What the trainer needs of a learner.

    Attributes:
        metrics: The names of what `update` returns.
        updates: Updates so far.
        precision: In which it computes; None before the first update.
    """

    metrics: tuple[str, ...]
    updates: int
    precision: str | None

    @property
    def network(self) -> Any:
        """The network, trained in place."""

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from [B] transitions; return metrics by name."""

    def choose_precision(self, wanted: str, batch: TensorDictBase) -> str:
        """Set and return the precision."""

    @property
    def averaged(self) -> Any:
        """A CPU copy of the network with averaged weights."""

    def state_dict(self) -> dict[str, Any]:
        """The state for a checkpoint."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state from a checkpoint."""


LEARNERS: dict[str, Callable[..., AnyLearner]] = {
    "double_dqn": Learner,
    "displacement": DisplacementLearner,
}


def build_learner(
    network: QNetwork, actions: Categorical, train: TrainConfig, device: str
) -> AnyLearner:
    """Wrap a network with the learner that it asks for; see `Learner`."""
    return LEARNERS[network.learner](network, actions, train, device)
