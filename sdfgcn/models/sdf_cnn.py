"""SDF CNN: all SDFs as the channels of one picture, without a graph (paper section VI B)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from sdfgcn.config import N_DIRECTIONS, ConvModelConfig, lookup
from sdfgcn.errors import SdfgcnError
from sdfgcn.models.layers import conv_block, q_head
from sdfgcn.models.pictures import PICTURES
from sdfgcn.models.q_network import QNetwork
from sdfgcn.validation import conv_sizes


class SdfCnn(QNetwork):
    """Convolutions over 2N channels, then N * 8 values at once.

    Channel i is the object in slot i, channel N + i the goal that it is matched with: without a
    graph, the order of the channels is all that says which goal is whose. The channels of empty
    slots, and of goals of objects without a match, are zero, the paper's padding.
    """

    def __init__(self, config: ConvModelConfig, max_objects: int, image_size: int):
        """Make the layers.

        Args:
            config: Features and widths.
            max_objects: N; pictures of another number of slots are refused.
            image_size: Height and width of the pictures, pixels.

        Raises:
            SdfgcnError: The config names features that there are not.
        """
        super().__init__(["sdf", "goal_sdf", "goal_node_mask", "correspondence"])
        self._picture = lookup(PICTURES, "model.features", config.features)
        self._unit = config.sdf_unit * image_size
        self._n = max_objects
        width = config.widths[config.width]
        blocks, n_channels = [], 2 * max_objects
        for block in zip(width.channels, width.strides, width.pooling, strict=True):
            blocks.append(conv_block(n_channels, *block))
            n_channels = block[0][-1]
        self.blocks = nn.Sequential(*blocks)
        size = conv_sizes(image_size, width.strides, width.pooling)[-1]
        self.head = q_head(n_channels * size**2, width.hidden, max_objects * N_DIRECTIONS)

    def action_values(self, observation: Mapping[str, Tensor]) -> Tensor:
        """See `QNetwork`.

        Raises:
            SdfgcnError: The observation has another number of slots than the network.
        """
        node_mask, sdf = observation["node_mask"], observation["sdf"]
        if node_mask.shape[-1] != self._n:
            raise SdfgcnError(
                f"The observation has {node_mask.shape[-1]} slots, but this sdf_cnn was built for "
                f"{self._n}; set env.max_objects={self._n}, or take a model with a graph."
            )
        goal = observation["correspondence"].clamp(min=0)
        matched = (observation["correspondence"] >= 0) & node_mask
        matched = matched & observation["goal_node_mask"].gather(1, goal)
        batch = torch.arange(len(goal), device=goal.device).unsqueeze(-1)
        picture = sdf.new_zeros(len(sdf), 2 * self._n, *sdf.shape[2:])
        picture[:, : self._n][node_mask] = self._picture(sdf[node_mask], self._unit)
        goals = observation["goal_sdf"][batch.expand_as(goal)[matched], goal[matched]]
        picture[:, self._n :][matched] = self._picture(goals, self._unit)
        values = self.head(self.blocks(picture)).float().unflatten(-1, (self._n, N_DIRECTIONS))
        return torch.where(node_mask.unsqueeze(-1), values, 0.0)
