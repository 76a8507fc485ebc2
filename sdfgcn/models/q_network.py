"""What all Q-networks share: how they are called by TorchRL."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor


class QNetwork(TensorDictModuleBase):
    """Reads an observation of any batch shape, writes the value of every action.

    A subclass registers with `sdfgcn.registry.MODELS` and is built with `(config.model,
    n_directions, max_objects, image_size)`. `*B` is the batch shape, N the number of rows, D that
    of push directions.

    Attributes:
        in_keys: The keys of the observation that are read, of shapes [*B, N, ...].
        out_keys: `action_value`, float32 [*B, N * D], in the order of `PushSpace`'s actions; 0 for
            rows whose `node_mask` is false.
        n_directions: D.
        fixed_rows: Whether the network takes observations of `env.max_objects` rows only.
    """

    fixed_rows: ClassVar[bool] = False

    def __init__(self, in_keys: Sequence[str], n_directions: int):
        """Name the keys; `node_mask` is always read."""
        super().__init__()
        self.in_keys = ["node_mask", *in_keys]
        self.out_keys = ["action_value"]
        self.n_directions = n_directions

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Set `action_value` and return the TensorDict."""
        values = {key: tensordict[key] for key in self.in_keys}
        *batch, n = values["node_mask"].shape
        flat = {key: value.reshape(-1, *value.shape[len(batch) :]) for key, value in values.items()}
        action_value = self.action_values(flat).reshape(*batch, n * self.n_directions)
        return tensordict.set("action_value", action_value)

    @abstractmethod
    def action_values(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return float32 [B, N, D] from the tensors of `in_keys`, each [B, N, ...]."""


def spread_to_rows(values: Tensor, node_mask: Tensor) -> Tensor:
    """Put the values of detected objects into their rows.

    Args:
        values: [M, D] of the M detected objects, in the order of `node_mask`.
        node_mask: bool [B, N].

    Returns:
        float32 [B, N, D], zero for the other rows.
    """
    spread = torch.zeros(*node_mask.shape, values.shape[-1], device=values.device)
    spread[node_mask] = values.float()
    return spread
