"""A table of finished runs beside the paper's figures.

    python experiments/table.py rule_based multirun/2026-01-31/12-00-00 outputs/2026-01-31/14-00-00
    python experiments/table.py rule_based FOLDER... --readme README.md

Takes every run folder at or below the given folders and writes `results/<name>.json` (each run's
`results.json`, its command line's overrides and the paper's figure) and `results/<name>.md`. With
`--readme`, the table is also inserted between the lines `<!-- results:<name> -->` and
`<!-- /results -->` of that file.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from common import RESULTS

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.report import markdown
from sdfgcn.evaluation.runs import collect
from sdfgcn.files import write_json, write_text

END = "<!-- /results -->"


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


def arguments_of(
    parser: argparse.ArgumentParser, given: Sequence[str] | None
) -> argparse.Namespace:
    """Parse the command line of a table: the parser's own arguments, and where files go."""
    parser.add_argument("--readme", type=Path, help="a file with marker lines to fill as well")
    parser.add_argument("--results", type=Path, default=RESULTS, help="where the files go")
    parsed = parser.parse_args(given)
    if not re.fullmatch(r"\w[\w.-]*", parsed.name):
        parser.error(f"NAME is '{parsed.name}', but must be a file name without folders.")
    return parsed


def publish(
    given: argparse.Namespace, name: str, make: Callable[[], tuple[str, Callable[[Path], None]]]
) -> int:
    """Write `<name>.md`, its companion files and the README's copy, and print the table.

    Args:
        given: What `arguments_of` returned.
        name: Name of the files and of the README's marker.
        make: Returns the table, and a function that writes the other files into a folder.

    Returns:
        The exit code: 1 after an error, which is printed on stderr.
    """
    try:
        table, write_others = make()
        readme = None
        if given.readme:  # before anything is written
            text = given.readme.read_text(encoding="utf-8")
            readme = filled(text, name, table, given.readme)
        given.results.mkdir(parents=True, exist_ok=True)
        write_others(given.results)
        write_text(given.results / f"{name}.md", table)
        if readme is not None:
            write_text(given.readme, readme)
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
