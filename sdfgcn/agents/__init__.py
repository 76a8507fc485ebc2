"""What picks the next push.

An agent ranks the pushes, and `EpsilonGreedy` takes one. Each agent registers with
`sdfgcn.registry.MODELS`, by what builds it from `(config, rng)`; a Q-network of `sdfgcn.models`
registers itself, and acts with the weights of a checkpoint.
"""

from __future__ import annotations

import numpy as np

from sdfgcn.agents.epsilon_greedy import EpsilonGreedy
from sdfgcn.agents.policy import trained_agent
from sdfgcn.config import Config
from sdfgcn.models import q_networks
from sdfgcn.registry import MODELS


def build_agent(config: Config, rng: np.random.Generator) -> EpsilonGreedy:
    """Build what picks the pushes: the agent that `config.model` names, as `config.eval` says.

    Raises:
        SdfgcnError: There is no such model, or `config.checkpoint` names no weights of it.
    """
    name = config.model.name
    agent = trained_agent(config) if name in q_networks() else MODELS.find(name)(config, rng)
    return EpsilonGreedy(agent, rng, config.eval.epsilon, config.eval.loop_distance)
