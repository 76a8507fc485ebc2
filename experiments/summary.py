"""The short table of the README: the main rows of the experiments' results.

    python experiments/summary.py

Rows are taken unchanged from `results/table1.json`, `table2.json` and `beyond.json`, if they exist,
and put between the lines `<!-- results:summary -->` and `<!-- /results -->` of README.md.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from common import RESULTS, ROOT, load
from table import filled

from sdfgcn.comparison.table import headline
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.report import decimal, markdown_table, percent
from sdfgcn.files import write_text

Row = dict[str, Any]

# The experiments, and the numbers of objects to show of each.
SHOWN = {"table1": (3,), "table2": (6,), "beyond": (3, 6)}
HEADS = (
    *("experiment", "conditions", "method", "n objects", "seeds", "episodes"),
    *("success rate", "paper", "pushes", "paper"),
)
NOTE = (
    "Held-out objects, env paper. In brackets: 95% intervals over training seeds and scenes; of "
    "one seed, they say nothing about others. Pushes are means over successful episodes. The "
    "paper's figures are for ShapeNet models. From"
)


def run(page: Path = ROOT / "README.md", results: Path = RESULTS) -> None:
    """Put the table between the page's marker lines.

    Raises:
        SdfgcnError: The page lacks the markers.
    """
    cells: list[list[str]] = []
    files = {name: results / f"{name}.json" for name in SHOWN}
    files = {name: file for name, file in files.items() if file.exists()}
    for name, file in files.items():
        rows = json.loads(file.read_text(encoding="utf-8"))
        cells += [_cells(name, row) for row in main_rows(name, rows, SHOWN[name])]
    named = ", ".join(f"`experiments/results/{name}.json`" for name in files)
    content = f"{markdown_table(HEADS, cells)}\n\n{NOTE} {named}.\n"
    write_text(page, filled(page.read_text(encoding="utf-8"), "summary", content, page))


def main_rows(name: str, rows: Sequence[Row], counts: Sequence[int]) -> list[Row]:
    """The rows of an experiment's main table on held-out objects, with so many objects."""
    experiment = load([f"experiment={name}"]).experiment
    return [
        row
        for row in headline(experiment, rows)
        if (row["split"], row["env"], row["success_threshold"]) == ("test", "paper", 0.05)
        and row["n_objects"] in counts
    ]


def _cells(name: str, row: Row) -> list[str]:
    helped = "" if row["loop_distance"] is None else ", loop-breaker"
    theirs = row["paper"] or {}
    cells = [name, f"{row['perception']}, epsilon {row['epsilon']}{helped}", row["method"]]
    cells += [str(row["n_objects"]), str(len(row["seeds"])), str(row["episodes"])]
    for key, show in (("success_rate", percent), ("pushes", decimal)):
        cells += [show(row[key], row[f"{key}_ci95"]), show(theirs.get(key))]
    return cells


if __name__ == "__main__":
    try:
        run()
    except SdfgcnError as error:
        print(error, file=sys.stderr)
        sys.exit(1)
