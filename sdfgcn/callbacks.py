"""Hydra callbacks of the command: where a run writes, and the table at the end of a sweep."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Any, ClassVar

from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig

from sdfgcn.evaluation.report import sweep_text
from sdfgcn.evaluation.runs import collect
from sdfgcn.signals import Terminated

_KEYS = ("hydra.run.dir", "hydra.sweep.dir")


class TellFolder(Callback):
    """Prints the folder of a run or sweep on stderr as it starts."""

    told: ClassVar[str | None] = None  # the override with which the command goes on in its folder

    def on_job_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the run folder; a sweep has printed its own."""
        if HydraConfig.get().mode is not RunMode.MULTIRUN:
            _tell("Run folder", "hydra.run.dir", HydraConfig.get().runtime.output_dir)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the sweep's folder."""
        _tell("Sweep folder", "hydra.sweep.dir", config.hydra.sweep.dir)


class SweepTable(Callback):
    """Ends a sweep with a table of its runs; an experiment has a table of its own."""

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Print the table."""
        if config.experiment.name == "none":
            folder = Path(config.hydra.sweep.dir)
            print(f"\n{sweep_text(collect([folder]))}\nSweep folder: {folder}")


def _tell(what: str, key: str, folder: str) -> None:
    TellFolder.told = f"{key}={_nearest(Path(folder))}"
    print(f"{what}: {_nearest(Path(folder))}", file=sys.stderr)


def _nearest(folder: Path) -> Path:
    """The folder as seen from here, if it is below."""
    here = Path.cwd()
    return folder.relative_to(here) if folder.is_relative_to(here) else folder


def how_to_go_on(error: KeyboardInterrupt) -> str:
    """What to say after Ctrl-C or a signal: the command that goes on, if there is a run."""
    reason = f"Stopped by {error.which.name}" if isinstance(error, Terminated) else "Interrupted"
    if TellFolder.told is None:
        return f"{reason}."
    program = Path(sys.argv[0]).name
    words = ["python", sys.argv[0]] if program.endswith(".py") else [program]
    given = [each for each in sys.argv[1:] if not each.startswith(_KEYS)]
    return f"{reason}; to go on: {shlex.join([*words, *given, TellFolder.told])}"
