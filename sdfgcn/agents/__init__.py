"""What picks the next push.

An agent is called with the observation of one environment (no batch dimension) and returns it
with `action` set. Each registers with `sdfgcn.registry.MODELS`, by what builds it from `(config,
rng)`; a Q-network of `sdfgcn.models` registers itself, and acts with the weights of a checkpoint.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from tensordict import TensorDictBase

from sdfgcn.agents.policy import trained_agent
from sdfgcn.config import Config
from sdfgcn.models import q_networks
from sdfgcn.registry import MODELS

Agent = Callable[[TensorDictBase], TensorDictBase]


def build_agent(config: Config, rng: np.random.Generator) -> Agent:
    """Build the agent that `config.model` names.

    Args:
        config: The whole experiment.
        rng: Where the agent draws from, and nowhere else.

    Raises:
        SdfgcnError: There is no such model, or `config.checkpoint` names no weights of it.
    """
    name = config.model.name
    build = trained_agent if name in q_networks() else MODELS.find(name)
    return build(config, rng)
