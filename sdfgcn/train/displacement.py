"""Supervised learning of where a push sends every object (`model=push_model`)."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.nn.functional import smooth_l1_loss
from torchrl.data import Categorical

from sdfgcn.config import TrainConfig
from sdfgcn.models.push_model import PushModel
from sdfgcn.train.base_learner import BaseLearner

MILLIMETRES = 1000.0


class DisplacementLearner(BaseLearner):
    """Fits the predicted displacements of a push model to the true ones.

    The targets are the true displacements of the objects near the pushed one. The mean is fitted by
    a smooth L1 loss, and the deviation by the likelihood of the errors that the mean makes; if both
    came from the likelihood, what is hard to foretell would hardly be learned (Seitzer et al.,
    2022).
    """

    network: PushModel
    metrics = ("loss", "error_mm", "moved_mm", "explained")
    module_key = "network"

    def __init__(
        self, network: PushModel, actions: Categorical, train: TrainConfig, device: str
    ) -> None:
        """Wrap a push model for learning; see `Learner` for the arguments."""
        self._device = torch.device(device)
        network = network.to(self._device)
        super().__init__(network, network, train)

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
        unit = self.network.config.unit
        error = (mean - moved) / unit
        spread = deviation / unit
        fit = smooth_l1_loss(error, torch.zeros_like(error), reduction="none").sum(dim=-1)
        squared = error.detach().square().sum(dim=-1)
        likelihood = 2.0 * spread.log() + 0.5 * squared / spread.square()
        terms = (fit + likelihood)[known]
        loss = terms.sum() / max(len(terms), 1)  # a batch in which nothing is known teaches nothing
        self._descend(loss)
        pushed = own & known
        wrong, way = (mean - moved).detach()[pushed], moved[pushed]
        return {
            "loss": float(loss.detach()),
            "error_mm": MILLIMETRES * float(wrong.norm(dim=-1).mean()),
            "moved_mm": MILLIMETRES * float(way.norm(dim=-1).mean()),
            "explained": 1.0 - float(wrong.square().sum() / way.square().sum().clamp_min(1e-9)),
        }


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
