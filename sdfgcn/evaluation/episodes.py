"""The result of an episode, and the table `episodes.csv`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from sdfgcn.errors import SdfgcnError
from sdfgcn.files import CsvTable


@dataclass(frozen=True)
class EpisodeResult:
    """The result of one episode: one row of `episodes.csv`.

    Attributes:
        episode: Its index in the evaluation, from 0.
        seed: Its own seed, which with the config determines start, goal and objects.
        n_objects: Objects on the table.
        objects: Object names in slot order, joined by ";".
        success: All objects were within the threshold of their goals at the same time.
        pushes: Pushes taken.
        error_mm: Final distance to the goal, mean over objects, millimetres.
        out_of_range: An object left the allowed region.
        truncated: The step limit ended the episode.
        return_: Undiscounted return; the column is called `return`.
        wall_s: Wall time, seconds.
    """

    episode: int
    seed: int
    n_objects: int
    objects: str
    success: bool
    pushes: int
    error_mm: float
    out_of_range: bool
    truncated: bool
    return_: float
    wall_s: float


COLUMNS = tuple(field.name.rstrip("_") for field in fields(EpisodeResult))
_READ: dict[str, Callable[[str], Any]] = {
    "int": int,
    "float": float,
    "str": str,
    "bool": {"True": True, "False": False}.__getitem__,
}


class EpisodeTable:
    """`episodes.csv`: each episode is saved as it ends, so an interrupted run can resume."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._table = CsvTable(path, COLUMNS)

    def read(self) -> list[EpisodeResult]:
        """Return the finished episodes, sorted by index; none if there is no file.

        Raises:
            SdfgcnError: The file is not a table of episodes.
        """
        try:
            episodes = {row["episode"]: _parse(row) for row in self._table.read()}
        except (KeyError, ValueError) as error:
            raise SdfgcnError(
                f"{self._path} is not a table of episodes (it has {error}); remove it or use "
                "another hydra.run.dir."
            ) from error
        return sorted(episodes.values(), key=lambda episode: episode.episode)

    def append(self, episode: EpisodeResult) -> None:
        """Append one row."""
        self._table.append(_row(episode))

    def write(self, episodes: Iterable[EpisodeResult]) -> None:
        """Replace the whole table."""
        self._table.write(map(_row, episodes))


def _row(episode: EpisodeResult) -> dict[str, Any]:
    return dict(zip(COLUMNS, asdict(episode).values(), strict=True))


def _parse(row: dict[str, str]) -> EpisodeResult:
    values = zip(fields(EpisodeResult), row.values(), strict=True)
    return EpisodeResult(**{field.name: _READ[str(field.type)](value) for field, value in values})
