"""Pose GCN and ground truth Pose GCN: positions as node features (paper section VI B)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import torch
from torch import Tensor, nn

from sdfgcn.config import PoseGcnConfig, lookup
from sdfgcn.graph import EDGES
from sdfgcn.models.layers import Propagation, linear_block, q_head
from sdfgcn.models.nodes import GRAPH_KEYS, OccupiedNodes
from sdfgcn.models.q_network import QNetwork, spread_to_slots

# The observation's key, and that of the goal.
POSITIONS: dict[str, tuple[str, str]] = {
    "center": ("center", "goal_center"),
    "position": ("position", "goal_position"),
}


class PoseGcn(QNetwork):
    """Sets of linear layers and MLP propagation over the graph of positions.

    Takes any number of slots.
    """

    def __init__(self, config: PoseGcnConfig, max_objects: int, image_size: int):
        """Make the layers.

        Args:
            config: Features, edges, propagation and widths.
            max_objects: Not used: the weights are the same for every node.
            image_size: Not used: there is no picture.

        Raises:
            SdfgcnError: The config names features, edges or a propagation that there are not.
        """
        keys = lookup(POSITIONS, "model.features", config.features)
        super().__init__([*keys, *GRAPH_KEYS])
        self._keys = keys
        lookup(EDGES, "model.edges", config.edges)
        self._edges = config.edges
        self._unit = config.position_unit
        self.blocks, self.propagations = nn.ModuleList(), nn.ModuleList()
        n_channels = 3  # x, y and the scene label
        for channels in config.channels:
            self.blocks.append(linear_block(n_channels, channels))
            n_channels = channels[-1]
            linear = partial(nn.Linear, n_channels, n_channels)
            self.propagations.append(Propagation(linear, config.propagation))
        self.head = q_head(n_channels, config.hidden)

    def action_values(self, observation: Mapping[str, Tensor]) -> Tensor:
        """See `QNetwork`."""
        nodes = OccupiedNodes(observation, self._edges)
        here, there = (observation[key] for key in self._keys)
        positions = nodes.gather(here, there) / self._unit
        rows = torch.cat([positions, nodes.is_goal.to(positions.dtype).unsqueeze(-1)], dim=-1)
        layers = list(zip(self.blocks, self.propagations, strict=True))
        for block, propagation in layers:
            last = propagation is layers[-1][1]
            rows = propagation(block(rows), nodes, current_only=last)
        return spread_to_slots(self.head(rows), observation["node_mask"])
