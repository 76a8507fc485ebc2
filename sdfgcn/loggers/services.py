"""Loggers that need optional packages."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path

from sdfgcn.config import LoggerConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import LOGGERS


@LOGGERS.register("tensorboard")
class TensorboardLogger:
    """Writes event files into `tensorboard` of the run folder."""

    def __init__(self, config: LoggerConfig, folder: Path) -> None:
        """Open the event file.

        Raises:
            SdfgcnError: The package is not installed.
        """
        _check_installed("tensorboard")
        from torchrl.record.loggers.tensorboard import TensorboardLogger as Events

        self._events = Events(exp_name="tensorboard", log_dir=str(folder))

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Write the metrics."""
        for name, value in figures.items():
            self._events.log_scalar(name, value, step=step)


@LOGGERS.register("wandb")
class WandbLogger:
    """Sends metrics to Weights & Biases, project sdfgcn; the run is named after the folder."""

    def __init__(self, config: LoggerConfig, folder: Path) -> None:
        """Start the run.

        Raises:
            SdfgcnError: The package is not installed.
        """
        _check_installed("wandb")
        from torchrl.record.loggers.wandb import WandbLogger as Run

        self._run = Run(exp_name=folder.name, save_dir=str(folder), project="sdfgcn")

    def log(self, step: int, figures: Mapping[str, float]) -> None:
        """Send the metrics."""
        for name, value in figures.items():
            self._run.log_scalar(name, value, step=step)


def _check_installed(package: str) -> None:
    if importlib.util.find_spec(package) is None:
        raise SdfgcnError(
            f"logger={package} needs a package that is not installed: "
            f"pip install 'sdfgcn[{package}]', or use logger=csv."
        )
