"""Recordings of episodes, one file each, to view push by push.

`RECORDERS` of the registry maps `viz.name` to a function that builds an episode's recorder:

    with RECORDERS.find(config.viz.name)(path, config.env) as recorder:
        recorder.start(env.episode_start)
        for step in steps:
            recorder.step(step)

The complete file appears at `path` only if the block ends without an exception.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from sdfgcn.registry import RECORDERS

if TYPE_CHECKING:
    from sdfgcn.config import EnvConfig
    from sdfgcn.envs.records import EpisodeStart, StepRecord


class Recorder(Protocol):
    """Records one episode: `start` once, `step` per push, `close` once."""

    def start(self, episode: EpisodeStart) -> None:
        """Record the start of the episode and its goal."""

    def step(self, step: StepRecord) -> None:
        """Record one push and the scene after it."""

    def close(self) -> None:
        """Finish the file; it does not appear without this call."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is None:
            self.close()


class NullRecorder(Recorder):
    """Records nothing (`viz=none`)."""

    def start(self, episode: EpisodeStart) -> None:
        """Do nothing."""

    def step(self, step: StepRecord) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


@RECORDERS.register("none")
def _null(path: Path, env: EnvConfig) -> Recorder:
    return NullRecorder()


@RECORDERS.register("rerun")
def _rerun(path: Path, env: EnvConfig) -> Recorder:
    # Imported here: rerun is slow to load, and a run without recordings does not need it.
    from sdfgcn.viz.rerun_recorder import RerunRecorder

    return RerunRecorder(path, env)
