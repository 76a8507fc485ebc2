"""The `page` section of `perception.py`: puts the main rows of both tables into the manual.

Rows are taken unchanged from `results/perception_segmentation.json` and `perception_matching.json`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from common import RESULTS, ROOT
from table import filled

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.report import percent
from sdfgcn.files import write_text

Row = dict[str, Any]
ALL = "2 to 6"  # n_objects of a row over all numbers of objects


def run(page: Path = ROOT / "docs" / "perception.md", results: Path = RESULTS) -> None:
    """Put both tables between the page's marker lines.

    Raises:
        SdfgcnError: A section has not been run yet, or the page lacks the markers.
    """
    text = page.read_text(encoding="utf-8")
    for section, table in TABLES.items():
        name = f"perception_{section}"
        rows = _rows(results / f"{name}.json", section)
        text = filled(text, name, table(rows), page)
    write_text(page, text)


def tables(results: Path = RESULTS) -> str:
    """Both tables, to look at."""
    made = (
        table(_rows(results / f"perception_{name}.json", name)) for name, table in TABLES.items()
    )
    return "\n".join(made)


def segmentation(rows: Sequence[Row]) -> str:
    """One row per catalogue and look; overlap and boundary over all numbers of objects."""
    lines = [
        "| objects | light and table | overlap F | boundary F | count right, 3 objects "
        "| 6 objects | 2 to 6 |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        if row["n_objects"] != ALL:
            continue
        alike = {other["n_objects"]: other for other in rows if _kind(other) == _kind(row)}
        counts = (
            percent(alike[n]["count_right"], alike[n]["count_right_ci95"]) for n in (3, 6, ALL)
        )
        lines.append(
            f"| {row['objects']} | {row['look']} | {row['overlap_f']:.3f} | "
            f"{row['boundary_f']:.3f} | {' | '.join(counts)} |"
        )
    return "\n".join(lines) + "\n"


def matching(rows: Sequence[Row]) -> str:
    """One row per number of objects: scenes wholly right, and by mean colour alone."""
    lines = [
        "| n objects | scenes | wholly right | by mean colour alone |",
        "| --- | --- | --- | --- |",
    ]
    for row in rows:
        shares = (
            percent(row[kind]["scenes_right"], row[kind]["scenes_right_ci95"], digits=1)
            for kind in ("matcher", "color_alone")
        )
        lines.append(f"| {row['n_objects']} | {row['scenes']} | {' | '.join(shares)} |")
    return "\n".join(lines) + "\n"


TABLES = {"segmentation": segmentation, "matching": matching}


def _kind(row: Row) -> tuple[str, str]:
    return row["objects"], row["look"]


def _rows(file: Path, section: str) -> list[Row]:
    try:
        return json.loads(file.read_text(encoding="utf-8"))["rows"]
    except FileNotFoundError as error:
        raise SdfgcnError(
            f"{file} is not there; run `python experiments/perception.py {section}` first."
        ) from error
