"""What picks the next push.

An agent is called with the observation of one environment (no batch dimension) and returns it
with `action` set. `MODELS` maps the options of `conf/model/` to builders.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from tensordict import TensorDictBase

from sdfgcn.agents.policy import load_network
from sdfgcn.agents.q_agent import QAgent
from sdfgcn.agents.rule_based import RuleBasedAgent
from sdfgcn.config import Config, lookup
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import Q_NETWORKS

Agent = Callable[[TensorDictBase], TensorDictBase]


def q_agent(config: Config, rng: np.random.Generator) -> Agent:
    """Build the agent of a trained Q-network.

    Raises:
        SdfgcnError: `config.checkpoint` names no weights of this model.
    """
    if config.checkpoint is None:
        raise SdfgcnError(
            f"model.name is '{config.model.name}', which needs trained weights: give checkpoint=..."
        )
    network, about = load_network(config.checkpoint)
    if config.model.name not in ("released", about["model"]["name"]):
        raise SdfgcnError(
            f"checkpoint={config.checkpoint} holds weights of model={about['model']['name']}, but "
            f"model.name is '{config.model.name}'."
        )
    return QAgent(network, rng, config.eval.epsilon, config.eval.loop_distance)


MODELS: dict[str, Callable[[Config, np.random.Generator], Agent]] = {
    "rule_based": RuleBasedAgent,
    "released": q_agent,
    **dict.fromkeys(Q_NETWORKS, q_agent),
}


def build_agent(config: Config, rng: np.random.Generator) -> Agent:
    """Build the agent that `config.model` names.

    Args:
        config: The whole experiment.
        rng: Where the agent draws from, and nowhere else.

    Raises:
        SdfgcnError: There is no such model.
    """
    return lookup(MODELS, "model.name", config.model.name)(config, rng)
