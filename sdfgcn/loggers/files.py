"""Loggers that need nothing but the run folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from sdfgcn.config import LoggerConfig
from sdfgcn.files import CsvTable
from sdfgcn.registry import LOGGERS


@LOGGERS.register("none")
class NoLogger:
    """Logs nothing."""

    def __init__(self, config: LoggerConfig, folder: Path) -> None:
        pass

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Do nothing."""


@LOGGERS.register("csv")
class CsvLogger:
    """Appends to `metrics.csv` of the run folder, one line `step,name,value` per metric."""

    def __init__(self, config: LoggerConfig, folder: Path) -> None:
        self._table = CsvTable(folder / "metrics.csv", ("step", "name", "value"))

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Append the metrics; they are in the file when this returns."""
        rows = ({"step": step, "name": name, "value": value} for name, value in figures.items())
        self._table.append(*rows)
