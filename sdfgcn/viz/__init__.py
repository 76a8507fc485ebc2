"""Recordings of episodes, one file each, to view push by push.

`RECORDERS` of the registry maps `viz.name` to a function that builds an episode's recorder:

    with RECORDERS.find(config.viz.name)(path, config.env, config.viz) as recorder:
        recorder.start(env.episode_start)
        for step in steps:
            recorder.step(step)

The complete file appears at `path`, with the suffix of its format, only if the block ends without
an exception.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from sdfgcn.registry import RECORDERS
from sdfgcn.viz.video_config import VideoConfig

if TYPE_CHECKING:
    from sdfgcn.config import EnvConfig, VizConfig
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


class SeveralRecorders(Recorder):
    """Passes an episode on to several recorders (`viz=both`)."""

    def __init__(self, *recorders: Recorder) -> None:
        """Take the recorders."""
        self._recorders = recorders
        self._open = ExitStack()

    def start(self, episode: EpisodeStart) -> None:
        """Start all of them."""
        for recorder in self._recorders:
            self._open.enter_context(recorder)
            recorder.start(episode)

    def step(self, step: StepRecord) -> None:
        """Record the push with all of them."""
        for recorder in self._recorders:
            recorder.step(step)

    def close(self) -> None:
        """Finish all files."""
        self._open.close()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._open.__exit__(None if error is None else type(error), error, None)


@RECORDERS.register("none")
def _null(path: Path, env: EnvConfig, viz: VizConfig | None = None) -> Recorder:
    return NullRecorder()


@RECORDERS.register("rerun")
def _rerun(path: Path, env: EnvConfig, viz: VizConfig | None = None) -> Recorder:
    # Imported here: rerun is slow to load, and a run without recordings does not need it.
    from sdfgcn.viz.rerun_recorder import RerunRecorder

    return RerunRecorder(path.with_suffix(".rrd"), env)


@RECORDERS.register("video", config=VideoConfig)
def _video(path: Path, env: EnvConfig, viz: VideoConfig) -> Recorder:
    # Imported here: it loads MuJoCo.
    from sdfgcn.viz.video_recorder import VideoRecorder

    return VideoRecorder(path, env, viz)


@RECORDERS.register("both", config=VideoConfig)
def _both(path: Path, env: EnvConfig, viz: VideoConfig) -> Recorder:
    return SeveralRecorders(_rerun(path, env), _video(path, env, viz))
