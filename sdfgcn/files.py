"""Atomic file writes, and CSV tables built on them."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sdfgcn.errors import SdfgcnError


@contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yield a temporary path whose file replaces `path` atomically when the block succeeds.

    The folder of `path` must exist. The temporary file lies in it and has the suffix of `path`,
    for libraries that infer the format from the name. It is removed if the block raises.
    """
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    part.unlink(missing_ok=True)  # left by a killed process
    try:
        yield part
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    with replaced(path) as part:
        part.write_text(text, encoding="utf-8")


def overwrite_json(path: Path, content: Any) -> None:
    """Overwrite an existing JSON file in place, which needs no room on a full disk.

    Not atomic: use it only where `write_json` failed. A file that grows may need a new block.

    Raises:
        OSError: There is no such file, or it cannot be written.
    """
    with path.open("r+", encoding="utf-8") as file:
        file.write(json.dumps(content, indent=2, allow_nan=False) + "\n")
        file.truncate()


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file atomically.

    Raises:
        ValueError: A number is not finite, which JSON cannot hold.
    """
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


class CsvTable:
    """A CSV file with a fixed header; each added row is written immediately."""

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        """Set the file and its header; nothing is read or written yet."""
        self._path = path
        self._columns = tuple(columns)
        self._whole = False  # whether the file is known to end with a complete line

    def read(self) -> list[dict[str, str]]:
        """Return the rows, keyed by column; none if there is no file.

        An incomplete last line, left by a killed process, is ignored.

        Raises:
            SdfgcnError: The file has other columns, or a row has too few or too many cells.
        """
        if not self._path.exists():
            return []
        text = self._path.read_text(encoding="utf-8")
        lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1])))
        uneven = any(len(cells) != len(self._columns) for cells in lines)
        if uneven or (lines and tuple(lines[0]) != self._columns):
            raise SdfgcnError(
                f"{self._path} is not a table with the columns {','.join(self._columns)}; remove "
                "it or use another folder."
            )
        return [dict(zip(self._columns, cells, strict=True)) for cells in lines[1:]]

    def append(self, *rows: Mapping[str, Any]) -> None:
        """Append rows; they are in the file when this returns."""
        if not self._whole:
            self.keep()
        with self._path.open("a", encoding="utf-8", newline="") as file:
            file.write(self._lines(rows))

    def write(self, rows: Iterable[Mapping[str, Any]]) -> None:
        """Replace the whole table atomically."""
        write_text(self._path, ",".join(self._columns) + "\n" + self._lines(rows))
        self._whole = True

    def keep(self, wanted: Callable[[dict[str, str]], bool] = lambda row: True) -> None:
        """Keep only the wanted rows; an incomplete last line is dropped too."""
        self.write([row for row in self.read() if wanted(row)])

    def _lines(self, rows: Iterable[Mapping[str, Any]]) -> str:
        text = io.StringIO()
        csv.DictWriter(text, self._columns, lineterminator="\n").writerows(rows)
        return text.getvalue()
