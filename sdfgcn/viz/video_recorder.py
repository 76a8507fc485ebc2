"""One episode as a film (`viz=video`)."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack, closing
from pathlib import Path

from PIL import Image

from sdfgcn.config import EnvConfig
from sdfgcn.envs.records import EpisodeStart, StepRecord
from sdfgcn.viz import Recorder
from sdfgcn.viz.video_config import VideoConfig
from sdfgcn.viz.video_files import FilmFile
from sdfgcn.viz.video_film import Film


class VideoRecorder(Recorder):
    """Writes one episode to one file, frame by frame; it appears when it is complete."""

    def __init__(self, path: Path, env: EnvConfig, viz: VideoConfig) -> None:
        """Prepare a film at `path`, whose suffix is that of `viz.format`.

        Nothing is written before `start`.
        """
        self._path, self._env, self._viz = path, env, viz
        self._stack = ExitStack()
        self._film: Film | None = None

    def start(self, episode: EpisodeStart) -> None:
        """Open the file and film the start.

        Raises:
            SdfgcnError: The file cannot be written, or there are no pictures to film.
        """
        self._file = self._stack.enter_context(FilmFile(self._path, self._viz))
        film = self._stack.enter_context(closing(Film(self._env, self._viz, episode)))
        self._film = film
        self._add(film.opening())

    def step(self, step: StepRecord) -> None:
        """Film one push."""
        assert self._film is not None, "start() comes first"
        self._add(self._film.push(step))

    def close(self) -> None:
        """Film the outcome and finish the file."""
        if self._film is not None:
            self._add(self._film.ending())
            self._film = None
            self._stack.close()

    def __exit__(self, kind, error, trace) -> None:
        """Finish the file, or remove what there is of it after an exception."""
        if error is None:
            self.close()
        else:
            self._stack.__exit__(kind, error, trace)

    def _add(self, frames: Iterable[Image.Image]) -> None:
        for frame in frames:
            self._file.add(frame)
