"""A table of finished runs beside the paper's figures.

    python experiments/table.py rule_based multirun/2026-01-31/12-00-00 outputs/2026-01-31/14-00-00
    python experiments/table.py rule_based FOLDER... --publish

Takes every run folder at or below the given folders and writes `<name>.json` (each run's
`results.json`, its command line's overrides and the paper's figure) and `<name>.md` to
`outputs/experiments`. With `--publish` they go to `experiments/results`, and the table also between
the lines `<!-- results:<name> -->` and `<!-- /results -->` of `README.md` or a file of `docs/`,
where there are such lines. `--page FILE` publishes likewise, to that file alone.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from common import PUBLISH, PUBLISH_HELP, ROOT, results_folder

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


def places_of(name: str) -> list[Path]:
    """The README and the pages of the docs that have the marker lines of a table."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [
        page for page in pages if f"<!-- results:{name} -->" in page.read_text(encoding="utf-8")
    ]


def arguments_of(
    parser: argparse.ArgumentParser, given: Sequence[str] | None
) -> argparse.Namespace:
    """Parse the command line of a table: the parser's own arguments, and where files go."""
    parser.add_argument(PUBLISH, action="store_true", help=f"{PUBLISH_HELP}, and to the docs")
    parser.add_argument("--page", type=Path, help="publish, with this file's marker lines")
    parser.add_argument("--results", type=Path, help="another folder for the files")
    parsed = parser.parse_args(given)
    if not re.fullmatch(r"\w[\w.-]*", parsed.name):
        parser.error(f"NAME is '{parsed.name}', but must be a file name without folders.")
    return parsed


def publish(
    given: argparse.Namespace, name: str, make: Callable[[], tuple[str, Callable[[Path], None]]]
) -> int:
    """Write `<name>.md`, its companion files and the copies in docs, and print the table.

    Args:
        given: What `arguments_of` returned.
        name: Name of the files and of the marker lines.
        make: Returns the table, and a function that writes the other files into a folder.

    Returns:
        The exit code: 1 after an error, which is printed on stderr.
    """
    try:
        table, write_others = make()
        places = [given.page] if given.page else places_of(name) if given.publish else []
        pages = {  # before anything is written
            place: filled(place.read_text(encoding="utf-8"), name, table, place) for place in places
        }
        folder = given.results or results_folder(given.publish or given.page is not None)
        folder.mkdir(parents=True, exist_ok=True)
        write_others(folder)
        write_text(folder / f"{name}.md", table)
        for place, page in pages.items():
            write_text(place, page)
    except (SdfgcnError, OSError) as error:
        print(error, file=sys.stderr)
        return 1
    print(table, end="")
    told = ", ".join(map(str, (folder / f"{name}.*", *places)))
    print(f"Wrote {told}.", file=sys.stderr)
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
