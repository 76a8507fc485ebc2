"""An episode's records as a file, to be drawn later, such as beside another agent's."""

from __future__ import annotations

import pickle
from pathlib import Path

from sdfgcn.config import EnvConfig, VizConfig
from sdfgcn.envs.records import EpisodeStart, StepRecord
from sdfgcn.files import replaced
from sdfgcn.viz import Recorder

SUFFIX = ".pickle"
Episode = tuple[EpisodeStart, list[StepRecord]]


class RecordsFile(Recorder):
    """Keeps the records themselves; the file appears when the episode is complete."""

    def __init__(self, path: Path, env: EnvConfig, viz: VizConfig) -> None:
        """Prepare a file at `path`, with the suffix `SUFFIX`."""
        self._path = path.with_suffix(SUFFIX)
        self._start: EpisodeStart | None = None
        self._steps: list[StepRecord] = []

    def start(self, episode: EpisodeStart) -> None:
        """Keep the start."""
        self._start = episode

    def step(self, step: StepRecord) -> None:
        """Keep a push."""
        self._steps.append(step)

    def close(self) -> None:
        """Write the file."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with replaced(self._path) as part:
            part.write_bytes(pickle.dumps((self._start, self._steps)))


def read_records(path: Path) -> Episode:
    """Read a file of our own: the start of the episode and its pushes."""
    start, steps = pickle.loads(path.read_bytes())
    return start, steps
