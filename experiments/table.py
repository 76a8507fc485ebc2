"""A table of finished runs beside the paper's figures.

    python experiments/table.py rule_based multirun/2026-01-31/12-00-00 outputs/2026-01-31/14-00-00
    python experiments/table.py rule_based FOLDER... --page docs/results.md

Takes every run folder at or below the given folders and writes `results/<name>.json` (each run's
`results.json`, its command line's overrides and the paper's figure) and `results/<name>.md`. With
`--page`, the table is also inserted between the lines `<!-- results:<name> -->` and
`<!-- /results -->` of that file.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from common import RESULTS

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.report import SHARED, markdown, paper
from sdfgcn.files import write_json, write_text

Row = dict[str, Any]

SORTED_BY = ("model", "split", "objects", "scenario", "perception", "n_objects", "robot", "seed")
END = "<!-- /results -->"


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
        rows |= {run: _row(_read(run / "results.json"), states[run]) for run in done}
    return sorted(rows.values(), key=_order)


def _order(row: Row) -> tuple:
    return (*(row[key] for key in SORTED_BY), *(str(row.get(key)) for key in SHARED))


def filled(text: str, name: str, content: str, file: Path) -> str:
    """Return `text` with `content` between the marker lines of the table `name`.

    Raises:
        SdfgcnError: The text lacks the markers.
    """
    begin = f"<!-- results:{name} -->"
    before, found, rest = text.partition(begin)
    old, end, after = rest.partition(END)
    if not (found and end) or "<!-- results:" in old:
        raise SdfgcnError(f"{file} has no lines {begin} and {END} to put the table between.")
    return f"{before}{begin}\n{content}{END}{after}"


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


def arguments_of(
    parser: argparse.ArgumentParser, given: Sequence[str] | None
) -> argparse.Namespace:
    """Parse the command line of a table: the parser's own arguments, and where files go."""
    parser.add_argument("--page", type=Path, help="a file with marker lines to fill as well")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where the files go")
    parsed = parser.parse_args(given)
    if not re.fullmatch(r"\w[\w.-]*", parsed.name):
        parser.error(f"NAME is '{parsed.name}', but must be a file name without folders.")
    return parsed


def publish(
    given: argparse.Namespace, name: str, make: Callable[[], tuple[str, Callable[[Path], None]]]
) -> int:
    """Write `<name>.md`, its companion files and the page's copy, and print the table.

    Args:
        given: What `arguments_of` returned.
        name: Name of the files and of the page's marker.
        make: Returns the table, and a function that writes the other files into a folder.

    Returns:
        The exit code: 1 after an error, which is printed on stderr.
    """
    try:
        table, write_others = make()
        page = None
        if given.page:  # before anything is written
            text = given.page.read_text(encoding="utf-8")
            page = filled(text, name, table, given.page)
        given.results.mkdir(parents=True, exist_ok=True)
        write_others(given.results)
        write_text(given.results / f"{name}.md", table)
        if page is not None:
            write_text(given.page, page)
    except (SdfgcnError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    print(table, end="")
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="A table of finished runs beside the paper's.")
    parser.add_argument("name", help="the files' name, such as rule_based")
    parser.add_argument("folders", nargs="+", type=Path, help="run folders, or a sweep's folder")
    given = arguments_of(parser, arguments)

    def make() -> tuple[str, Callable[[Path], None]]:
        rows = collect(given.folders)
        return markdown(rows), lambda folder: write_json(folder / f"{given.name}.json", rows)

    return publish(given, given.name, make)


if __name__ == "__main__":
    sys.exit(main())
