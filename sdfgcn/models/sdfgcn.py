"""SDFGCN and its ablations over pictures: Segmentation GCN, SDFGCN-separate (paper section V)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import torch
from torch import Tensor, nn

from sdfgcn.config import ConvGcnConfig, lookup
from sdfgcn.graph import EDGES
from sdfgcn.models.layers import Propagation, conv_block, in_channels_last, q_head
from sdfgcn.models.nodes import GRAPH_KEYS, OccupiedNodes
from sdfgcn.models.pictures import PICTURES
from sdfgcn.models.q_network import QNetwork, spread_to_slots
from sdfgcn.validation import conv_sizes


class SdfGcn(QNetwork):
    """Sets of CNN block and CNN propagation layer over the SDF scene graph (paper Fig. 4).

    Takes any number of slots.
    """

    def __init__(self, config: ConvGcnConfig, max_objects: int, image_size: int):
        """Make the layers.

        Args:
            config: Features, edges, propagation and widths.
            max_objects: Not used: the weights are the same for every node.
            image_size: Height and width of the pictures, pixels.

        Raises:
            SdfgcnError: The config names features, edges or a propagation that there are not.
        """
        super().__init__(["sdf", "goal_sdf", *GRAPH_KEYS])
        lookup(EDGES, "model.edges", config.edges)
        self._edges = config.edges
        self._picture = lookup(PICTURES, "model.features", config.features)
        self._unit = config.sdf_unit * image_size
        width = config.widths[config.width]
        self.blocks, self.propagations = nn.ModuleList(), nn.ModuleList()
        n_channels = 2  # the picture and the scene label
        for block in zip(width.channels, width.strides, width.pooling, strict=True):
            self.blocks.append(conv_block(n_channels, *block))
            n_channels = block[0][-1]
            conv = partial(nn.Conv2d, n_channels, n_channels, 3, padding=1)
            self.propagations.append(Propagation(conv, config.propagation))
        size = conv_sizes(image_size, width.strides, width.pooling)[-1]
        self.head = q_head(n_channels * size**2, width.hidden)

    def action_values(self, observation: Mapping[str, Tensor]) -> Tensor:
        """See `QNetwork`."""
        nodes = OccupiedNodes(observation, self._edges)
        picture = nodes.gather(observation["sdf"], observation["goal_sdf"])
        picture = self._picture(picture, self._unit)
        label = nodes.is_goal.to(picture.dtype)[:, None, None].expand_as(picture)
        # Channels last, where the weights are: else each convolution would copy its input twice.
        dim = -1 if in_channels_last(self.blocks[0]) else 1
        rows = torch.stack([picture, label], dim).movedim(dim, 1)
        layers = list(zip(self.blocks, self.propagations, strict=True))
        for block, propagation in layers:
            last = propagation is layers[-1][1]
            rows = propagation(block(rows), nodes, current_only=last)
        return spread_to_slots(self.head(rows), observation["node_mask"])
