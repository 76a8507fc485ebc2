"""The folders of a sweep, so that its jobs' states are right however the sweep ends."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

from sdfgcn.run_folder import mark_stopped


class SweepFolders(Callback):
    """Notes where the jobs of a sweep write."""

    folders: ClassVar[tuple[Path, ...]] = ()

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Note the sweep's folder, and that of an experiment's trainings."""
        folders = [Path(config.hydra.sweep.dir).resolve()]
        if config.experiment.name != "none":
            folders.append(Path(config.experiment.trainings).resolve())
        SweepFolders.folders = tuple(folders)


@contextlib.contextmanager
def stopped_jobs_marked() -> Iterator[None]:
    """Mark the jobs that were killed because the sweep in this block was stopped."""
    try:
        yield
    except KeyboardInterrupt as error:
        for folder in SweepFolders.folders:
            mark_stopped(folder, error)
        raise
