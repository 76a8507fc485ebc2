"""Pose GCN and ground truth Pose GCN: positions as node features (paper section VI B)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

import torch
from torch import Tensor, nn
from torch.nn.functional import pad

from sdfgcn.config import QNetworkConfig, number, one_of, several
from sdfgcn.models.graph import EDGES, OccupiedNodes
from sdfgcn.models.graph_network import GraphQNetwork
from sdfgcn.models.layers import (
    PROPAGATIONS,
    Propagation,
    check_widths,
    linear_block,
    q_head,
)
from sdfgcn.registry import MODELS
from sdfgcn.task.scene import Scene

# The positions that a network can read from a scene, [*B, N, 2] in metres.
POSITIONS: dict[str, Callable[[Scene], Tensor]] = {
    "center": attrgetter("center"),
    "position": attrgetter("position"),
}


@dataclass
class PoseGcnConfig(QNetworkConfig):
    """A graph convolutional Q-network over positions (`conf/model/pose_gcn.yaml`).

    Attributes:
        features: The position in the node features, a key of `POSITIONS`.
        position_unit: The unit of length of the node features, metres.
        channels: Units of each linear layer, one list per block.
        hidden: Units between the last two linear layers.
    """

    features: str = one_of(*POSITIONS)
    position_unit: float = number(0.0001, 1000)
    channels: list[list[int]] = several(1, 4096)
    hidden: int = number(1, 16_384)
    edges: str = one_of(*EDGES)
    propagation: str = one_of(*PROPAGATIONS)

    def check_network(self, image_size: int) -> None:
        """See `QNetworkConfig`."""
        super().check_network(image_size)
        check_widths("model.channels", self.channels, self.channels)


@MODELS.register("pose_gcn", "gt_pose_gcn", config=PoseGcnConfig)
class PoseGcn(GraphQNetwork):
    """Blocks of linear layers, each followed by MLP propagation, over the graph of positions."""

    def __init__(self, config: PoseGcnConfig, n_directions: int, max_objects: int, image_size: int):
        """Make the layers; see `QNetwork` for the arguments."""
        super().__init__(config, n_directions, max_objects, image_size)
        self._position = POSITIONS[config.features]
        self.edges, self.propagation = config.edges, config.propagation
        self._unit = config.position_unit
        self.blocks, self.propagations = nn.ModuleList(), nn.ModuleList()
        n_channels = 3  # x, y and the scene label
        for channels in config.channels:
            self.blocks.append(linear_block(n_channels, channels))
            n_channels = channels[-1]
            linear = partial(nn.Linear, n_channels, n_channels)
            self.propagations.append(Propagation(linear, config.propagation))
        self.head = q_head(n_channels, config.hidden, n_directions)

    def encode(self, scene: Scene, goal: Scene, nodes: OccupiedNodes) -> Tensor:
        """See `GraphQNetwork`; the features are the positions and the scene label."""
        parts = nodes.gather(self._position(scene), self._position(goal))
        rows = [pad(part / self._unit, (0, 1), value=label) for label, part in enumerate(parts)]
        return self.blocks[0](torch.cat(rows))
