"""SDF CNN: all SDFs as the channels of one picture, without a graph (paper section VI B)."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from sdfgcn.errors import SdfgcnError
from sdfgcn.models.layers import conv_block, q_head
from sdfgcn.models.pictures import PICTURES, ConvConfig
from sdfgcn.models.q_network import QNetwork
from sdfgcn.registry import MODELS
from sdfgcn.task.scene import Scene


@MODELS.register("sdf_cnn", config=ConvConfig)
class SdfCnn(QNetwork):
    """Convolutions over 2N channels, then all N * D values at once.

    Channel i is the object in row i, channel N + i its matched goal: without a graph, only the
    order of the channels tells which goal belongs to which object. The channels of empty rows and
    of unmatched goals are zero, as in the paper's padding.
    """

    fixed_rows: ClassVar[bool] = True

    def __init__(self, config: ConvConfig, n_directions: int, max_objects: int, image_size: int):
        """Make the layers; see `QNetwork` for the arguments."""
        super().__init__(config, n_directions, max_objects, image_size)
        self._picture = PICTURES[config.features]
        self._unit = config.sdf_unit * image_size
        width = config.widths[config.width]
        blocks, n_channels = [], 2 * max_objects
        for block in zip(width.channels, width.strides, width.pooling, strict=True):
            blocks.append(conv_block(n_channels, *block))
            n_channels = block[0][-1]
        self.blocks = nn.Sequential(*blocks)
        size = width.final_size(image_size)
        self.head = q_head(n_channels * size**2, width.hidden, max_objects * n_directions)

    def action_values(self, scene: Scene, goal: Scene, matched: Tensor) -> Tensor:
        """See `QNetwork`.

        Raises:
            SdfgcnError: The observation's number of rows differs from the network's.
        """
        node_mask, n = scene.node_mask, self.max_objects
        if node_mask.shape[-1] != n:
            raise SdfgcnError(
                f"The observation has {node_mask.shape[-1]} rows, but this sdf_cnn was built for "
                f"{n}; set env.max_objects={n}, or take a model with a graph."
            )
        matched = matched & node_mask & goal.node_mask
        sdf = scene.sdf
        picture = sdf.new_zeros(len(sdf), 2 * n, *sdf.shape[2:])
        picture[:, :n][node_mask] = self._picture(sdf[node_mask], self._unit)
        picture[:, n:][matched] = self._picture(goal.sdf[matched], self._unit)
        values = self.head(self.blocks(picture)).float().unflatten(-1, (n, self.n_directions))
        return torch.where(node_mask.unsqueeze(-1), values, 0.0)
