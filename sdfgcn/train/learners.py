"""What trains a network: one learner for each kind of network."""

from __future__ import annotations

from collections.abc import Callable

from torchrl.data import Categorical

from sdfgcn.config import TrainConfig
from sdfgcn.models.q_network import QNetwork
from sdfgcn.train.base_learner import BaseLearner
from sdfgcn.train.displacement import DisplacementLearner
from sdfgcn.train.learner import Learner

LEARNERS: dict[str, Callable[..., BaseLearner]] = {
    "double_dqn": Learner,
    "displacement": DisplacementLearner,
}


def build_learner(
    network: QNetwork, actions: Categorical, train: TrainConfig, device: str
) -> BaseLearner:
    """Wrap a network with the learner that it asks for; see `Learner`."""
    return LEARNERS[network.learner](network, actions, train, device)
