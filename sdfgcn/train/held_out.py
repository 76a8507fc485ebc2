"""The learning curve on held-out objects: greedy evaluations during training."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch

from sdfgcn.files import CsvTable
from sdfgcn.loggers import Logger
from sdfgcn.models.q_network import QNetwork

# Plays held-out episodes greedily and returns a value for each of FIGURES.
Evaluate = Callable[[QNetwork], dict[str, float]]
FIGURES = ("episodes", "success_rate", "episode_pushes", "error_mm", "out_of_range_rate")


class HeldOutCurve:
    """`eval.csv`, with a row every `train.eval_pushes` pushes."""

    def __init__(
        self, folder: Path, logger: Logger, every: int | None, evaluate: Evaluate | None
    ) -> None:
        """Start an empty curve; nothing is written before the first evaluation.

        Args:
            folder: The run folder.
            logger: Also receives each row; its step is the number of pushes.
            every: Pushes between evaluations; None disables them.
            evaluate: Plays the episodes.
        """
        self._table = CsvTable(folder / "eval.csv", ("pushes", *FIGURES))
        self._file = folder / "eval.csv"
        self._logger = logger
        self._every = every
        self._evaluate = evaluate
        self._last = 0

    def go_on_from(self, pushes: int) -> None:
        """Resume at `pushes` pushes; later rows are dropped, as they will be written again."""
        self._last = pushes
        if self._file.exists():
            self._table.keep(lambda row: int(row["pushes"]) <= pushes)

    def pushed(self, pushes: int, network: Callable[[], QNetwork]) -> None:
        """Evaluate if an evaluation is due.

        Args:
            pushes: Pushes so far in the training.
            network: Returns the current network.
        """
        if self._evaluate is None or self._every is None:
            return
        if pushes // self._every > self._last // self._every:
            with torch.random.fork_rng():  # evaluation must not affect training
                figures = self._evaluate(network())
            self._table.append({"pushes": pushes, **figures})
            self._logger.log(pushes, {f"eval/{name}": value for name, value in figures.items()})
        self._last = pushes
