"""The short table of the README: the main rows of the experiments' results.

    python experiments/summary.py              prints it
    python experiments/summary.py --publish    puts it into README.md

Rows are taken unchanged from `results/table1.json`, `table2.json` and `beyond.json`, if they exist.
Publishing one of these tables (`comparison.py --publish`) publishes this one, too.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from common import PUBLISH, RESULTS, ROOT, load, parse, run
from table import filled

from sdfgcn.comparison.table import headline
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


def publish(page: Path = ROOT / "README.md", results: Path = RESULTS) -> None:
    """Put the table between the page's marker lines.

    Raises:
        SdfgcnError: The page lacks the markers.
    """
    write_text(page, filled(page.read_text(encoding="utf-8"), "summary", table(results), page))


def table(results: Path = RESULTS) -> str:
    """The table, and what its columns mean."""
    cells: list[list[str]] = []
    files = {name: results / f"{name}.json" for name in SHOWN}
    files = {name: file for name, file in files.items() if file.exists()}
    for name, file in files.items():
        rows = json.loads(file.read_text(encoding="utf-8"))
        cells += [_cells(name, row) for row in main_rows(name, rows, SHOWN[name])]
    named = ", ".join(f"`experiments/results/{name}.json`" for name in files)
    return f"{markdown_table(HEADS, cells)}\n\n{NOTE} {named}.\n"


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


def main(arguments: Sequence[str]) -> None:
    parse(arguments, {}, __doc__ or "")
    if PUBLISH in arguments:
        publish()
    else:
        print(table(), end="")


if __name__ == "__main__":
    sys.exit(run(lambda: main(sys.argv[1:])))
