"""A Q-network of one linear layer, quick enough to train in tests."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn

from sdfgcn.config import N_DIRECTIONS, Config


class SmallNetwork(TensorDictModuleBase):
    """Values of each object's 8 directions from its offset to the goal and its shrunken SDF."""

    in_keys = ("sdf", "goal_sdf", "position", "goal_position")
    out_keys = ("action_value",)

    def __init__(self) -> None:
        super().__init__()
        self.hidden = nn.Linear(2 + 2 * 9, 32)
        self.values = nn.Linear(32, N_DIRECTIONS)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        pictures = [
            tensordict[key][..., 16::32, 16::32].flatten(-2) / 100.0 for key in ("sdf", "goal_sdf")
        ]
        offset = 10.0 * (tensordict["goal_position"] - tensordict["position"])
        hidden = torch.relu(self.hidden(torch.cat([offset, *pictures], dim=-1)))
        tensordict["action_value"] = self.values(hidden).flatten(-2)
        return tensordict


def small_network(config: Config, max_objects: int) -> SmallNetwork:
    with torch.random.fork_rng():
        torch.manual_seed(config.seed)
        return SmallNetwork()
