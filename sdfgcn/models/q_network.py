"""What all Q-networks share: how they are called by TorchRL."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from sdfgcn.config import N_DIRECTIONS


class QNetwork(TensorDictModuleBase):
    """Reads an observation of any batch shape, writes the value of every action.

    `*B` is the batch shape, N the number of slots.

    Attributes:
        in_keys: The keys of the observation that are read, of shapes [*B, N, ...].
        out_keys: `action_value`, float32 [*B, N * 8], object-major as the action of
            `RearrangementEnv`; 0 for slots whose `node_mask` is false.
    """

    def __init__(self, in_keys: Sequence[str]):
        """Name the keys; `node_mask` is always read."""
        super().__init__()
        self.in_keys = ["node_mask", *in_keys]
        self.out_keys = ["action_value"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Set `action_value` and return the TensorDict."""
        values = {key: tensordict[key] for key in self.in_keys}
        *batch, n = values["node_mask"].shape
        flat = {key: value.reshape(-1, *value.shape[len(batch) :]) for key, value in values.items()}
        action_value = self.action_values(flat).reshape(*batch, n * N_DIRECTIONS)
        return tensordict.set("action_value", action_value)

    @abstractmethod
    def action_values(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return float32 [B, N, 8] from the tensors of `in_keys`, each [B, N, ...]."""


def spread_to_slots(rows: Tensor, node_mask: Tensor) -> Tensor:
    """Put the values of occupied slots in their places.

    Args:
        rows: [M, 8] values of the M occupied slots, in the order of `node_mask`.
        node_mask: bool [B, N].

    Returns:
        float32 [B, N, 8], zero for the other slots.
    """
    values = torch.zeros(*node_mask.shape, N_DIRECTIONS, device=rows.device)
    values[node_mask] = rows.float()
    return values
