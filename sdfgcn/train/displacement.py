"""Supervised learning of where a push sends every object (`model=push_model`)."""

from __future__ import annotations

import copy
from typing import Any, cast

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import smooth_l1_loss
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torchrl.data import Categorical

from sdfgcn.config import TrainConfig
from sdfgcn.models.push_model import PushModel

MILLIMETRES = 1000.0


class DisplacementLearner:
    """Holds everything that an update changes: network, averaged weights and optimiser.

    The targets are the true displacements of the objects near the pushed one. The mean is fitted by
    a smooth L1 loss, and the deviation by the likelihood of the errors that the mean makes; if both
    came from the likelihood, what is hard to foretell would hardly be learned (Seitzer et al.,
    2022).
    """

    metrics: tuple[str, ...] = ("loss", "error_mm", "moved_mm", "explained")

    def __init__(
        self, network: PushModel, actions: Categorical, train: TrainConfig, device: str
    ) -> None:
        """Wrap a push model for learning; see `Learner` for the arguments."""
        self._device = torch.device(device)
        self.network = network.to(self._device)
        self._train = train
        self._optimiser = torch.optim.Adam(self.network.parameters(), lr=train.learning_rate)
        self._average = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(train.ema_decay)
        )
        self.updates = 0
        self.precision: str | None = None

    def choose_precision(self, wanted: str, batch: TensorDictBase) -> str:
        """Set the precision: always float32, as the network is small."""
        self.precision = "float32"
        return self.precision

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from [B] transitions.

        Returns:
            Metrics by name: `loss`; of the pushed objects, the mean error and the mean displacement
            in millimetres, and the share of the squared displacement that is explained.
        """
        batch = batch.to(self._device)
        mean, deviation, moved, own, known = _predicted(self.network, batch)
        unit = self.network.unit
        error = (mean - moved) / unit
        spread = deviation / unit
        fit = smooth_l1_loss(error, torch.zeros_like(error), reduction="none").sum(dim=-1)
        squared = error.detach().square().sum(dim=-1)
        likelihood = 2.0 * spread.log() + 0.5 * squared / spread.square()
        loss = (fit + likelihood)[known].mean()
        self._optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self._train.max_gradient_norm)
        self._optimiser.step()
        self._average.update_parameters(self.network)
        self.updates += 1
        pushed = own & known
        wrong, way = (mean - moved).detach()[pushed], moved[pushed]
        return {
            "loss": float(loss.detach()),
            "error_mm": MILLIMETRES * float(wrong.norm(dim=-1).mean()),
            "moved_mm": MILLIMETRES * float(way.norm(dim=-1).mean()),
            "explained": 1.0 - float(wrong.square().sum() / way.square().sum().clamp_min(1e-9)),
        }

    @property
    def averaged(self) -> PushModel:
        """A CPU copy of the network with the exponential moving average of its weights."""
        return cast(PushModel, copy.deepcopy(self._average.module).cpu())

    def state_dict(self) -> dict[str, Any]:
        """Network, averaged weights, optimiser and counter, for a checkpoint."""
        return {
            "network": self.network.state_dict(),
            "average": self._average.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "updates": self.updates,
            "precision": self.precision,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state from a checkpoint."""
        self.network.load_state_dict(state["network"])
        self._average.load_state_dict(state["average"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.updates = int(state["updates"])
        self.precision = state["precision"]


def _predicted(
    network: PushModel, batch: TensorDictBase
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Predicted and true displacements by the taken pushes of [B] transitions.

    Returns:
        mean [B, N, 2] and deviation [B, N], metres; true displacements [B, N, 2], metres; bool
        [B, N] which row was pushed; bool [B, N] which rows are predicted and known.
    """
    scene, after, action = batch["scene"], batch["next", "scene"], batch["action"]
    rows, direction = action // network.n_directions, action % network.n_directions
    moves = network.moves(scene, rows[:, None], mirrored=False)
    each = torch.arange(len(rows), device=rows.device)
    mean = moves.mean[each, 0, :, direction]
    deviation = moves.deviation[each, 0, :, direction]
    known = moves.near[:, 0] & batch["matched"] & batch["next", "matched"]
    own = torch.zeros_like(known).scatter_(1, rows[:, None], True)
    return mean, deviation, after.position - scene.position, own, known
