"""An episode's records in memory, to be drawn later, such as beside another agent's."""

from __future__ import annotations

from sdfgcn.envs.records import EpisodeStart, StepRecord
from sdfgcn.viz import Recorder

Episode = tuple[EpisodeStart, list[StepRecord]]


class Records(Recorder):
    """Keeps the records themselves.

    Attributes:
        episode: The start of the episode and its pushes; None before the start.
    """

    def __init__(self) -> None:
        """Start without records."""
        self.episode: Episode | None = None

    def start(self, episode: EpisodeStart) -> None:
        """Keep the start."""
        self.episode = episode, []

    def step(self, step: StepRecord) -> None:
        """Keep a push."""
        assert self.episode is not None, "start() comes first"
        self.episode[1].append(step)

    def close(self) -> None:
        """Do nothing: there is no file."""
