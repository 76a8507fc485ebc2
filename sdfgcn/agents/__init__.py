"""What picks the next push.

An agent is called with the observation of one environment (no batch dimension) and returns it
with `action` set. `MODELS` maps the options of `conf/model/` to builders.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from tensordict import TensorDictBase

from sdfgcn.agents.rule_based import RuleBasedAgent
from sdfgcn.config import Config, lookup
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import Q_NETWORKS

Agent = Callable[[TensorDictBase], TensorDictBase]


def untrained(config: Config, rng: np.random.Generator) -> Agent:
    """Refuse: a Q-network's weights come from training.

    Raises:
        SdfgcnError: Always.
    """
    raise SdfgcnError(
        f"model.name is '{config.model.name}', which has no trained weights; take model=rule_based."
    )


MODELS: dict[str, Callable[[Config, np.random.Generator], Agent]] = {
    "rule_based": RuleBasedAgent,
    **dict.fromkeys(Q_NETWORKS, untrained),
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
