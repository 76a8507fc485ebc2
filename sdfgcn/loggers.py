"""Running figures of a run (`conf/logger/`), besides its result files."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol


class Logger(Protocol):
    """Takes figures as a run goes on."""

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Take figures by name at a step, for example after an episode."""


class NoLogger:
    """Keeps nothing."""

    def __init__(self, folder: Path) -> None:
        pass

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Drop the figures."""


class CsvLogger:
    """Appends to `metrics.csv` of the run folder: one line a figure, `step,name,value`."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "metrics.csv"

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Append the figures; they are in the file when this returns."""
        new = not self._path.exists()
        with self._path.open("a", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            if new:
                writer.writerow(("step", "name", "value"))
            writer.writerows((step, name, value) for name, value in figures.items())


LOGGERS: dict[str, Callable[[Path], Logger]] = {"csv": CsvLogger, "none": NoLogger}
