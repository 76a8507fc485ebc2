"""The training loop: collect, store, learn, report, evaluate and checkpoint."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from tensordict import TensorDictBase
from torch import Tensor

from sdfgcn.config import Config
from sdfgcn.files import write_json
from sdfgcn.models.q_network import QNetwork
from sdfgcn.train.base_learner import BaseLearner
from sdfgcn.train.checkpoint import save_checkpoint
from sdfgcn.train.collectors import PushCollector
from sdfgcn.train.curriculum import Curriculum
from sdfgcn.train.exploration import EpsilonGreedyPolicy
from sdfgcn.train.held_out import HeldOutCurve
from sdfgcn.train.hindsight import Hindsight
from sdfgcn.train.progress import Progress
from sdfgcn.train.replay import Replay
from sdfgcn.train.state_file import encoded

# What a training has taken so far: `pushes`, `updates` and `hours`.
Spent = dict[str, float]
# Called with the network with averaged weights, on the CPU, and what it took.
KeepNetwork = Callable[[QNetwork, Spent], None]

_REST_BYTES = 2**26  # in a checkpoint: unfinished episodes, generators, counters, JSON


@dataclass(frozen=True)
class TrainingState:
    """All that a checkpoint holds except the collector's state.

    Attributes:
        learner: Network, averaged weights and optimiser.
        policy: Picks the pushes.
        replay: The replay buffer.
        hindsight: Makes transitions with other goals.
        curriculum: Sets the number of objects.
        progress: Counters and recent metrics.
    """

    learner: BaseLearner
    policy: EpsilonGreedyPolicy
    replay: Replay
    hindsight: Hindsight
    curriculum: Curriculum
    progress: Progress

    def parts(self, collector: dict[str, Any]) -> dict[str, Any]:
        """The parts of a checkpoint by name; `collector` is saved, or filled when loading."""
        return {
            "learner": self.learner,
            "policy": self.policy,
            "replay": self.replay,
            "hindsight": self.hindsight,
            "curriculum": self.curriculum,
            "progress": self.progress,
            "collector": collector,
        }

    @property
    def largest(self) -> int:
        """Bytes that a checkpoint can have unpacked; larger ones are not of this training.

        That is a full replay buffer and the learner, both doubled: Adam's moments come with the
        first update, and they are two thirds of what the networks take. The rest is small.
        """
        tensors: dict[str, Tensor] = {}
        encoded(self.learner.state_dict(), tensors)
        learner = sum(tensor.nbytes for tensor in tensors.values())
        return self.replay.largest + 2 * learner + _REST_BYTES


class Trainer:
    """Trains until the budget is spent."""

    def __init__(
        self,
        config: Config,
        state: TrainingState,
        collector: PushCollector,
        curve: HeldOutCurve,
        checkpoint: Path,
        learning_config: dict[str, Any],
        keep_network: KeepNetwork,
    ) -> None:
        """Take the parts of the training.

        Args:
            config: The whole experiment.
            state: Everything that training changes.
            collector: Collects pushes.
            curve: Evaluates on held-out scenes.
            checkpoint: The archive to write.
            learning_config: The config values that identify the training.
            keep_network: Called with the network at each checkpoint.
        """
        self._config = config
        self._state = state
        self._learner, self._policy, self._replay = state.learner, state.policy, state.replay
        self._hindsight, self._curriculum = state.hindsight, state.curriculum
        self._progress = state.progress
        self._collector = collector
        self._curve = curve
        self._checkpoint = checkpoint
        self._learning_config = learning_config
        self._keep_network = keep_network
        self._saved = time.monotonic()

    def run(self) -> None:
        """Train until the budget is spent."""
        budget = self._config.budget
        self._progress.open(self._learner.updates, budget.pushes, budget.minutes)
        while not self._finished():
            self._remember(self._collector.collect(meanwhile=self._update_within_limit))
            self._learn()
            self._progress.tell(
                self._learner.updates, self._policy.epsilon, self._curriculum.newest
            )
            self._curve.pushed(self._progress.pushes, lambda: self.averaged)
            if time.monotonic() - self._saved > 60.0 * self._config.train.checkpoint_minutes:
                self._save()
        self._save()

    @property
    def averaged(self) -> QNetwork:
        """A CPU copy of the network with averaged weights."""
        return cast(QNetwork, self._learner.averaged)

    def close(self) -> None:
        """Close the live line and the collector."""
        self._progress.close()
        self._collector.close()

    def _finished(self) -> bool:
        budget = self._config.budget
        late = budget.minutes is not None and self._progress.seconds > 60.0 * budget.minutes
        return late or self._progress.pushes >= budget.pushes

    def _remember(self, collected: TensorDictBase) -> None:
        """Store [T] pushes in the replay buffer, with their hindsight copies."""
        self._progress.pushed(collected)
        self._policy.pushed(len(collected))
        self._curriculum.pushed(collected)
        transitions = self._replay.stored(collected)
        self._replay.extend(transitions)
        self._replay.extend(self._hindsight(transitions, collected["collector", "traj_ids"]))

    def _learn(self) -> None:
        """Do the updates that are due, and pass the weights to the collector."""
        while self._learner.updates < self._due(self._config.train.utd_ratio):
            self._update()
        self._policy.load_weights(self._learner.network)
        self._collector.update_policy_weights()

    def _due(self, utd_ratio: float) -> int:
        late = self._progress.pushes - self._config.train.learning_starts
        return int(utd_ratio * max(late, 0))

    def _update_within_limit(self) -> bool:
        """Do one update if `max_utd_ratio` allows it; return whether it did."""
        if self._learner.updates >= self._due(self._config.train.max_utd_ratio):
            return False
        self._update()
        return True

    def _update(self) -> None:
        batch = self._replay.sample()
        if self._learner.precision is None:
            self._choose_precision(batch)
        self._progress.updated(self._learner.update(batch))

    def _choose_precision(self, batch: TensorDictBase) -> None:
        """Choose it once per run folder: a resume must not pick another by timing again."""
        wanted, kept = self._config.runtime.precision, self._checkpoint.with_name("precision.json")
        if wanted == "auto" and kept.exists():
            wanted = json.loads(kept.read_text(encoding="utf-8"))["precision"]
        chosen = self._learner.choose_precision(wanted, batch)
        if self._config.runtime.precision == "auto":
            write_json(kept, {"precision": chosen})

    def _save(self) -> None:
        parts = self._state.parts(self._collector.state())
        save_checkpoint(self._checkpoint, parts, self._learning_config)
        self._keep_network(self.averaged, self._spent())
        self._saved = time.monotonic()

    def _spent(self) -> Spent:
        return {
            "pushes": self._progress.pushes,
            "updates": self._learner.updates,
            "hours": round(self._progress.seconds / 3600.0, 3),
        }
