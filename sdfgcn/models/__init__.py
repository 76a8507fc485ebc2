"""Q-networks: from an observation to the value of every object and direction.

`Q_NETWORKS` maps the learned options of `conf/model/` to builders.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from sdfgcn.config import ModelConfig, lookup
from sdfgcn.models.layers import initialise
from sdfgcn.models.pose_gcn import PoseGcn
from sdfgcn.models.q_network import QNetwork
from sdfgcn.models.sdf_cnn import SdfCnn
from sdfgcn.models.sdfgcn import SdfGcn
from sdfgcn.validation import validate_model

# Called with the model's config, the number of slots and the picture's size in pixels.
Q_NETWORKS: dict[str, Callable[[Any, int, int], QNetwork]] = {
    "sdfgcn": SdfGcn,
    "separate": SdfGcn,
    "segmentation_gcn": SdfGcn,
    "pose_gcn": PoseGcn,
    "gt_pose_gcn": PoseGcn,
    "sdf_cnn": SdfCnn,
}


def build_q_network(
    config: ModelConfig,
    max_objects: int,
    image_size: int,
    generator: torch.Generator | int,
    device: torch.device | str = "cpu",
) -> QNetwork:
    """Build the Q-network that `config` names, with weights drawn from `generator` alone.

    Args:
        config: The `model` part of the experiment's config.
        max_objects: N, the slots of an observation (`env.max_objects`).
        image_size: Height and width of the pictures, pixels (`env.arena.image_size`).
        generator: Where the initial weights are drawn from, on the CPU, or a seed; torch's global
            generator is left alone.
        device: Where the network is to live.

    Returns:
        A TensorDictModule that reads `in_keys` and writes `action_value`.

    Raises:
        SdfgcnError: There is no such network, or its config contradicts itself.
    """
    build = lookup(Q_NETWORKS, "model.name", config.name)
    validate_model(config, image_size)
    if isinstance(generator, int):
        generator = torch.Generator().manual_seed(generator)
    with torch.device("meta"):  # else torch would draw weights from its global generator
        network = build(config, max_objects, image_size)
    network.to_empty(device="cpu")
    initialise(network, generator)
    return network.to(device)
