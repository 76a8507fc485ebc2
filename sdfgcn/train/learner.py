"""Double DQN (paper sections III A and V C): network, target network, loss and optimiser."""

from __future__ import annotations

import copy
import time
from contextlib import nullcontext
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.data import Categorical
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss, HardUpdate

from sdfgcn.config import TrainConfig, lookup

PRECISIONS = {"float32": None, "bfloat16": torch.bfloat16}
TRIALS = 2  # updates that are timed for each precision
TRIAL_BATCH = 4  # transitions in each


class Learner:
    """Holds everything that an update changes."""

    def __init__(
        self, network: TensorDictModuleBase, actions: Categorical, train: TrainConfig, device: str
    ) -> None:
        """Wrap a Q-network for learning.

        Args:
            network: Sets `action_value` [*B, N * D]; it is trained in place.
            actions: The spec of an action.
            train: The learning's numbers.
            device: Where to compute.
        """
        self._train = train
        self._device = torch.device(device)
        # A third less time an update on a CPU, and nothing else changes.
        self.network = network.to(self._device).to(memory_format=torch.channels_last)
        self.precision: str | None = None  # chosen before the first update
        self._loss = DQNLoss(
            q_actor(network, actions),
            loss_function=train.loss,
            double_dqn=True,
            delay_value=True,
            action_space="categorical",
        )
        self._loss.make_value_estimator(gamma=train.discount)
        self._loss.to(self._device)
        # TorchRL's counter fires one step after the interval.
        self._target = HardUpdate(
            self._loss, value_network_update_interval=train.target_interval - 1
        )
        self._optimiser = torch.optim.Adam(self._loss.parameters(), lr=train.learning_rate)
        # Single updates change what a greedy policy does; their average is steadier.
        self._average = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(train.ema_decay)
        )
        self.updates = 0

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from [B] transitions.

        Returns:
            Figures by name: `loss`.
        """
        batch = batch.to(self._device)
        loss = self._loss_of(batch)
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self._loss.parameters(), self._train.max_gradient_norm)
        self._optimiser.step()
        self._target.step()
        self._average.update_parameters(self.network)
        self.updates += 1
        return {"loss": float(loss.detach())}

    @property
    def averaged(self) -> TensorDictModuleBase:
        """The network with the weights' exponential moving average over updates; a CPU copy."""
        return copy.deepcopy(self._average.module).cpu()

    def choose_precision(self, wanted: str, batch: TensorDictBase) -> str:
        """Set the precision; `auto` times both on copies of this learner and takes the faster.

        Args:
            wanted: "float32", "bfloat16" or "auto".
            batch: [B] transitions to try.

        Returns:
            The one that was taken.
        """
        if wanted == "auto":
            # A few transitions are enough, and where bfloat16 is slow, it is slow indeed.
            wanted = min(PRECISIONS, key=lambda name: self._seconds(name, batch[:TRIAL_BATCH]))
        lookup(PRECISIONS, "runtime.precision", wanted)
        self.precision = wanted
        return wanted

    def _seconds(self, precision: str, batch: TensorDictBase) -> float:
        trial = copy.deepcopy(self)
        trial.precision = precision
        trial.update(batch)  # the first allocates
        clock = time.perf_counter()
        for _ in range(TRIALS):
            trial.update(batch)
        return time.perf_counter() - clock

    def _loss_of(self, batch: TensorDictBase) -> torch.Tensor:
        dtype = PRECISIONS[self.precision or "float32"]
        cast = nullcontext() if dtype is None else torch.autocast(self._device.type, dtype)
        with cast:
            return self._loss(batch)["loss"]

    def state_dict(self) -> dict[str, Any]:
        """Network, its average, target network, optimiser and counters, for a checkpoint."""
        return {
            "loss": self._loss.state_dict(),
            "average": self._average.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "updates": self.updates,
            "precision": self.precision,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what a checkpoint kept."""
        self._loss.load_state_dict(state["loss"])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.updates = int(state["updates"])
        self.precision = state["precision"]
        self._target.counter = self.updates % self._train.target_interval


def q_actor(network: TensorDictModuleBase, actions: Categorical) -> QValueActor:
    """A network as a greedy policy over the legal actions."""
    return QValueActor(
        module=network,
        spec=actions,
        action_space="categorical",
        action_mask_key="action_mask",
    )
