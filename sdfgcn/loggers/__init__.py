"""Running figures of a run (`conf/logger/`), besides its result files.

Each module here registers loggers with `sdfgcn.registry.LOGGERS`: what builds one from its config
and the run folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol


class Logger(Protocol):
    """Takes figures as a run goes on."""

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Take figures by name at a step, for example after an episode."""
