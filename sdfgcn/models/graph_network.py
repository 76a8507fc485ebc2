"""The base class of Q-networks over the scene graph."""

from __future__ import annotations

from abc import abstractmethod
from itertools import islice

import torch
from torch import Tensor, nn

from sdfgcn.models.graph import OccupiedNodes
from sdfgcn.models.layers import PROPAGATIONS
from sdfgcn.models.q_network import QNetwork, spread_to_rows
from sdfgcn.task.scene import Scene


class GraphQNetwork(QNetwork):
    """Blocks, each followed by propagation along the edges, then a head (paper Fig. 4).

    A subclass makes the layers and implements `encode`. Accepts any number of rows.

    Attributes:
        edges: A key of `EDGES`.
        propagation: A key of `PROPAGATIONS`.
        blocks: Layers that look at one node at a time.
        propagations: A `Propagation` after each block.
        head: From a node's features to the values of its pushes.
    """

    edges: str
    propagation: str
    blocks: nn.ModuleList
    propagations: nn.ModuleList
    head: nn.Module

    @abstractmethod
    def encode(self, scene: Scene, goal: Scene, nodes: OccupiedNodes) -> Tensor:
        """The output of the first block, [M, ...]."""

    def action_values(self, scene: Scene, goal: Scene, matched: Tensor) -> Tensor:
        """See `QNetwork`."""
        return self._values(scene, goal, matched, scene.node_mask)

    def row_values(self, scene: Scene, goal: Scene, matched: Tensor, rows: Tensor) -> Tensor:
        """See `QNetwork`; the values of all other rows are 0."""
        numbers = torch.arange(matched.shape[-1], device=rows.device)
        asked = scene.node_mask & (numbers == rows.unsqueeze(-1))
        return self._values(scene, goal, matched, asked)

    def _values(self, scene: Scene, goal: Scene, matched: Tensor, asked: Tensor) -> Tensor:
        """The values [B, N, D], of the rows `asked` [B, N] alone."""
        fixed_shares = PROPAGATIONS[self.propagation].fixed_shares
        nodes = OccupiedNodes(
            scene, goal, matched, self.edges, len(self.blocks), asked, fixed_shares
        )
        rows = self.propagations[0](self.encode(scene, goal, nodes), nodes.hops[0])
        layers = zip(self.blocks, self.propagations, nodes.hops, strict=True)
        for block, propagation, hop in islice(layers, 1, None):
            rows = propagation(block(rows), hop)
        return spread_to_rows(self.head(rows), asked)
