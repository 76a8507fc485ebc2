"""Q-networks: from an observation to the value of each object and direction.

Each network registers with `sdfgcn.registry.MODELS` where it is defined.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch

from sdfgcn.config import ModelConfig, QNetworkConfig, lookup
from sdfgcn.models.layers import initialise
from sdfgcn.models.q_network import QNetwork
from sdfgcn.registry import MODELS


def q_networks() -> dict[str, type[QNetwork]]:
    """Every Q-network of `conf/model/` by name."""
    return {
        name: model
        for name, model in MODELS.items()
        if isinstance(model, type) and issubclass(model, QNetwork)
    }


def build_q_network(
    config: ModelConfig,
    n_directions: int,
    max_objects: int,
    image_size: int,
    generator: torch.Generator | int,
    device: torch.device | str = "cpu",
) -> QNetwork:
    """Build the Q-network that `config` names, with initial weights drawn from `generator` alone.

    Args:
        config: The `model` part of the experiment's config.
        n_directions: D, the push directions of each object (`env.push.directions`).
        max_objects: N, the rows of an observation (`env.max_objects`).
        image_size: Height and width of the pictures, pixels (`env.arena.image_size`).
        generator: Source of the initial weights, on the CPU, or a seed; torch's global generator
            is left unchanged.
        device: Where to put the network.

    Returns:
        A TensorDictModule that reads `in_keys` and writes `action_value`.

    Raises:
        SdfgcnError: There is no such network, or its config is inconsistent.
    """
    build = _checked(config, image_size)
    if isinstance(generator, int):
        generator = torch.Generator().manual_seed(generator)
    with torch.random.fork_rng(devices=[]):  # layers draw from the global generator first
        torch.manual_seed(generator.initial_seed())
        network = build(n_directions, max_objects, image_size)
    initialise(network, generator)
    return network.to(device)


def empty_q_network(
    config: ModelConfig, n_directions: int, max_objects: int, image_size: int
) -> QNetwork:
    """The same network without memory, to see which weights it has; see `build_q_network`.

    Raises:
        SdfgcnError: There is no such network, or its config is inconsistent.
    """
    with torch.device("meta"):
        return _checked(config, image_size)(n_directions, max_objects, image_size)


def _checked(config: ModelConfig, image_size: int) -> Callable[[int, int, int], QNetwork]:
    """What builds the network, given the numbers of directions and rows and the picture's size."""
    build = lookup(q_networks(), "model.name", config.name)
    assert isinstance(config, QNetworkConfig)
    config.check_network(image_size)
    return partial(build, config)
