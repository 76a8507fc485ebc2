"""The trained weights that come with the package (`conf/model/released.yaml`)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sdfgcn.agents.epsilon_greedy import QAgent
from sdfgcn.agents.policy import trained_agent
from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import MODELS


@dataclass
class ReleasedConfig(QNetworkConfig):
    """The Q-network that `checkpoint` names; evaluated, never trained."""

    def check(self, config: Config) -> None:
        """See `ComponentConfig`."""
        if config.checkpoint is None:
            raise SdfgcnError(
                "checkpoint is null, but model=released is never trained: give the name of a "
                "released policy or the folder of a trained one."
            )


@MODELS.register("released", config=ReleasedConfig)
def released(config: Config, rng: np.random.Generator) -> QAgent:
    """Build the agent from the weights that `config.checkpoint` names; `rng` is unused."""
    return trained_agent(config)
