"""The finished runs in folders, as rows of a table."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.report import SHARED, paper

Row = dict[str, Any]

_SORTED_BY = ("model", "split", "objects", "scenario", "perception", "n_objects", "robot", "seed")


def collect(folders: Iterable[Path]) -> list[Row]:
    """Read the finished runs at or below the folders; list unfinished ones on stderr.

    Returns:
        One row per run: its `results.json`, with `overrides`, `ended` and `paper` added.

    Raises:
        SdfgcnError: A folder holds no finished run, or a run's file is damaged.
    """
    rows: dict[Path, Row] = {}
    for folder in folders:
        runs = {status.parent.resolve() for status in folder.rglob("status.json")}
        states = {run: _read(run / "status.json") for run in runs}
        done = {run for run in runs if states[run].get("state") == "done"}
        if not done:
            raise SdfgcnError(
                f"{folder} holds no finished run; give run folders (or a sweep's folder) whose "
                "status.json says done."
            )
        for run in sorted(runs - done):
            print(f"Left out: {run} ({states[run].get('state')}).", file=sys.stderr)
        rows |= {run: _row(_read(run / "results.json"), states[run]) for run in sorted(done)}
    return sorted(rows.values(), key=_order)


def _order(row: Row) -> tuple:
    return (*(row[key] for key in _SORTED_BY), *(str(row.get(key)) for key in SHARED))


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SdfgcnError(f"{file} cannot be read ({error}); run it again.") from error
    return content


def _row(results: dict[str, Any], status: dict[str, Any]) -> Row:
    return {
        **results,
        "overrides": status.get("overrides"),
        "ended": status.get("ended"),
        "paper": paper(results),
    }
