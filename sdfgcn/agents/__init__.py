"""What picks the next push.

An agent ranks the pushes, and `EpsilonGreedy` takes one. Each agent registers a builder that takes
`(config, rng)` with `sdfgcn.registry.MODELS`; a Q-network of `sdfgcn.models` registers itself and
acts with the weights of a checkpoint.
"""

from __future__ import annotations

import numpy as np

from sdfgcn.agents.epsilon_greedy import EpsilonGreedy
from sdfgcn.agents.policy import trained_agent
from sdfgcn.config import Config
from sdfgcn.models import q_networks
from sdfgcn.registry import MODELS


def build_agent(config: Config, rng: np.random.Generator) -> EpsilonGreedy:
    """Build the agent that `config.model` names, with the exploration that `config.eval` sets.

    Raises:
        SdfgcnError: There is no such model, or `config.checkpoint` names no weights of it.
    """
    name = config.model.name
    agent = trained_agent(config) if name in q_networks() else MODELS.find(name)(config, rng)
    return EpsilonGreedy(agent, rng, config.eval.epsilon, config.eval.loop_distance)
