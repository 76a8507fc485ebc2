"""The table of an experiment (`experiment=table1`, ...) from the folder of its sweep.

    python experiments/comparison.py table1 multirun/table1
    python experiments/comparison.py table1 multirun/table1 --publish
    python experiments/comparison.py table1 multirun/table1 --seeds 0 --partial

Writes `<name>.json` (every row), `<name>.md` and figures, `<name>_*.png`, to `outputs/experiments`;
`--publish` and `--page` are as in `table.py`, and `--publish` renews the README's table, too. A
missing method, seed or cell is an error; ask for less with `--methods` and `--seeds`, or leave out
unfinished cells with `--partial`.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import summary
from common import load, run
from table import arguments_of, publish

from sdfgcn.comparison.plan import Plan
from sdfgcn.comparison.report import write_report


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="The table of an experiment.")
    parser.add_argument("name", help="an option of conf/experiment/, such as table1")
    parser.add_argument("folder", type=Path, help="the sweep's folder, such as multirun/table1")
    parser.add_argument("--methods", nargs="+", help="the methods to show; all by default")
    parser.add_argument("--seeds", nargs="+", type=int, help="the training seeds; all by default")
    parser.add_argument("--partial", action="store_true", help="leave out unfinished cells")
    given = arguments_of(parser, arguments)
    return run(lambda: _table(given))


def _table(given: argparse.Namespace) -> int:
    config = load([f"experiment={given.name}"])
    plan = Plan(config.experiment, config.budget, ())
    methods = given.methods or list(config.experiment.methods)
    seeds = given.seeds or list(range(config.budget.seeds))

    def make() -> tuple[str, Callable[[Path], None]]:
        with tempfile.TemporaryDirectory() as scratch:
            table = write_report(plan, given.folder, methods, seeds, Path(scratch), given.partial)
            files = {path.name: path.read_bytes() for path in Path(scratch).iterdir()}

        def write(results: Path) -> None:
            for name, content in files.items():
                (results / name).write_bytes(content)

        return table, write

    failed = publish(given, given.name, make)
    if given.publish and not (failed or given.results) and given.name in summary.SHOWN:
        summary.publish()
    return failed


if __name__ == "__main__":
    sys.exit(main())
