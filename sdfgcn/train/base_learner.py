"""What all learners share: gradient descent, averaged weights, and their state."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from sdfgcn.config import TrainConfig
from sdfgcn.errors import SdfgcnError


class BaseLearner(ABC):
    """Holds everything that an update changes: network, averaged weights and optimiser.

    Attributes:
        metrics: The names of what `update` returns.
        module_key: The key of the trained module's state in a checkpoint.
        network: Trained in place.
        updates: Updates so far.
        precision: In which it computes; None before the first update.
    """

    metrics: ClassVar[tuple[str, ...]] = ("loss",)
    module_key: ClassVar[str]

    def __init__(
        self, network: TensorDictModuleBase, module: nn.Module, train: TrainConfig
    ) -> None:
        """Make the optimiser and the averaged weights.

        Args:
            network: The network, on its device.
            module: Holds the network and whatever else a checkpoint needs; its parameters are
                trained.
            train: The hyperparameters.
        """
        self.network = network
        self.updates = 0
        self.precision: str | None = None
        self._train = train
        self._module = module
        self._optimiser = torch.optim.Adam(module.parameters(), lr=train.learning_rate)
        # The greedy policy fluctuates from update to update; that of averaged weights is steadier.
        self._average = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(train.ema_decay)
        )

    @abstractmethod
    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from [B] transitions; return metrics by name."""

    @abstractmethod
    def choose_precision(self, wanted: str, batch: TensorDictBase) -> str:
        """Set and return the precision, given `runtime.precision` and [B] transitions."""

    def _descend(self, loss: Tensor) -> None:
        """Do one step down the gradient of a loss.

        Raises:
            SdfgcnError: The loss or its gradient is not finite; the weights are as before.
        """
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        largest = self._train.max_gradient_norm
        norm = nn.utils.clip_grad_norm_(self._module.parameters(), largest)
        if not (loss.detach().isfinite() & norm.isfinite()):
            raise SdfgcnError(
                f"In update {self.updates + 1}, the loss is {float(loss.detach()):g} and the norm "
                f"of its gradient {float(norm):g}, so training cannot go on: lower "
                f"train.learning_rate (now {self._train.learning_rate:g}), or use "
                "runtime.precision=float32."
            )
        self._optimiser.step()
        self._average.update_parameters(self.network)
        self.updates += 1

    @property
    def averaged(self) -> TensorDictModuleBase:
        """A CPU copy of the network with the exponential moving average of its weights."""
        return copy.deepcopy(self._average.module).cpu()

    def state_dict(self) -> dict[str, Any]:
        """The trained module, averaged weights, optimiser and counter, for a checkpoint."""
        return {
            self.module_key: self._module.state_dict(),
            "average": self._average.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "updates": self.updates,
            "precision": self.precision,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state from a checkpoint."""
        self._module.load_state_dict(state[self.module_key])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.updates = int(state["updates"])
        self.precision = state["precision"]
