"""Loggers for the running metrics of a run (`conf/logger/`), besides its result files.

Each module registers loggers with `sdfgcn.registry.LOGGERS`, built from their config and the run
folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol


class Logger(Protocol):
    """Receives metrics during a run."""

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Log metrics by name at a step, for example after an episode."""
