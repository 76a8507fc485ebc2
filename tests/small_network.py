"""A Q-network of one hidden layer, quick enough to train in tests."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.models.q_network import QNetwork
from sdfgcn.task.scene import Scene


class SmallNetwork(QNetwork):
    """Values each object's pushes by its offset to the goal and its shrunken SDFs."""

    def __init__(
        self, config: QNetworkConfig, n_directions: int, max_objects: int, image_size: int
    ) -> None:
        super().__init__(config, n_directions, max_objects, image_size)
        self.hidden = nn.Linear(2 + 2 * 9, 32)
        self.values = nn.Linear(32, n_directions)

    def action_values(self, scene: Scene, goal: Scene, matched: Tensor) -> Tensor:
        pictures = [each.sdf[..., 16::32, 16::32].flatten(-2) / 100.0 for each in (scene, goal)]
        offset = 10.0 * (goal.position - scene.position)
        return self.values(torch.relu(self.hidden(torch.cat([offset, *pictures], dim=-1))))


def small_network(config: Config, max_objects: int) -> SmallNetwork:
    assert isinstance(config.model, QNetworkConfig)
    size, n_directions = config.env.arena.image_size, config.env.push.directions
    with torch.random.fork_rng():
        torch.manual_seed(config.seed)
        return SmallNetwork(config.model, n_directions, max_objects, size)
