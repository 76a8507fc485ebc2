"""The curve of held-out success: greedy evaluations while a network is trained."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import torch

from sdfgcn.files import CsvTable
from sdfgcn.loggers import Logger
from sdfgcn.models.q_network import QNetwork

# Plays held-out episodes greedily and returns figures by name, one for each of FIGURES.
Evaluate = Callable[[QNetwork], dict[str, float]]
FIGURES = ("episodes", "success_rate", "episode_pushes", "error_mm", "out_of_range_rate")


class HeldOutCurve:
    """`eval.csv`: a row every so many pushes (`train.eval_pushes`)."""

    def __init__(
        self, folder: Path, logger: Logger, every: int | None, evaluate: Evaluate | None
    ) -> None:
        """Make an empty curve; nothing is written before the first evaluation.

        Args:
            folder: The run folder.
            logger: Takes each row as well; its step is the number of pushes.
            every: Pushes between two evaluations; None: there are none.
            evaluate: Plays the episodes.
        """
        self._table = CsvTable(folder / "eval.csv", ("pushes", *FIGURES))
        self._file = folder / "eval.csv"
        self._logger = logger
        self._every = every
        self._evaluate = evaluate
        self._last = 0

    def go_on_from(self, pushes: int) -> None:
        """Drop the rows after so many pushes: those are done again."""
        self._last = pushes
        if self._file.exists():
            self._table.keep(lambda row: int(row["pushes"]) <= pushes)

    def pushed(self, pushes: int, network: Callable[[], QNetwork]) -> None:
        """Evaluate if it is time.

        Args:
            pushes: Pushes of the training so far.
            network: Returns the network of now.
        """
        if self._evaluate is None or self._every is None:
            return
        if pushes // self._every > self._last // self._every:
            with torch.random.fork_rng():  # the training goes on as if nobody had looked
                figures = self._evaluate(network())
            self._table.append({"pushes": pushes, **figures})
            self._logger.log(pushes, {f"eval/{name}": value for name, value in figures.items()})
        self._last = pushes
