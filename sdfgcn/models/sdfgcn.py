"""SDFGCN and its ablations over pictures: Segmentation GCN, SDFGCN-separate (paper section V)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor, nn

from sdfgcn.config import one_of
from sdfgcn.models.graph import EDGES, OccupiedNodes
from sdfgcn.models.graph_network import GraphQNetwork
from sdfgcn.models.layers import (
    PROPAGATIONS,
    Propagation,
    conv_block,
    labelled_block,
    q_head,
)
from sdfgcn.models.pictures import PICTURES, ConvConfig
from sdfgcn.registry import MODELS
from sdfgcn.task.scene import Scene


@dataclass
class ConvGcnConfig(ConvConfig):
    """A graph convolutional Q-network over pictures (`conf/model/sdfgcn.yaml` and ablations)."""

    edges: str = one_of(*EDGES)
    propagation: str = one_of(*PROPAGATIONS)


@MODELS.register("sdfgcn", "separate", "segmentation_gcn", config=ConvGcnConfig)
class SdfGcn(GraphQNetwork):
    """CNN blocks, each followed by CNN propagation, over the SDF scene graph (paper Fig. 4)."""

    def __init__(self, config: ConvGcnConfig, n_directions: int, max_objects: int, image_size: int):
        """Make the layers; see `QNetwork` for the arguments."""
        super().__init__(config, n_directions, max_objects, image_size)
        self.edges, self.propagation = config.edges, config.propagation
        self._picture = PICTURES[config.features]
        self._unit = config.sdf_unit * image_size
        width = config.widths[config.width]
        self.blocks, self.propagations = nn.ModuleList(), nn.ModuleList()
        n_channels = 2  # the picture and the scene label
        for block in zip(width.channels, width.strides, width.pooling, strict=True):
            self.blocks.append(conv_block(n_channels, *block))
            n_channels = block[0][-1]
            conv = partial(nn.Conv2d, n_channels, n_channels, 3, padding=1)
            self.propagations.append(Propagation(conv, config.propagation))
        size = width.final_size(image_size)
        self.head = q_head(n_channels * size**2, width.hidden, n_directions)

    def encode(self, scene: Scene, goal: Scene, nodes: OccupiedNodes) -> Tensor:
        """See `GraphQNetwork`; the features are the pictures and the scene label."""
        parts = [
            labelled_block(self.blocks[0], self._picture(sdf, self._unit), is_goal)
            for is_goal, sdf in enumerate(nodes.gather(scene.sdf, goal.sdf))
        ]
        return torch.cat(parts)
