"""The learning curve of a training, as a picture and as a short table.

    python experiments/learning_curve.py sdfgcn outputs/2026-01-31/14-00-00
    python experiments/learning_curve.py sdfgcn FOLDER --rows 12 --publish

Copies the `train.csv` of a run folder to `outputs/experiments/<name>_curve.csv` and writes a
table of rows evenly spaced in time (`.md`) and a picture (`.png`). `--publish` and `--page` are
as in `table.py`, with the lines `<!-- results:<name>_curve -->` and `<!-- /results -->`.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from table import arguments_of, publish

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.report import decimal, markdown_table, percent
from sdfgcn.files import replaced, write_text

Row = dict[str, float]

NOTE = (
    "Success and out of range: the last 100 training episodes at that time, pushes random with "
    "probability epsilon. Loss: the mean of the last 100 updates."
)


def read(folder: Path) -> list[Row]:
    """The rows of a run folder's `train.csv`.

    Raises:
        SdfgcnError: The file is missing, empty or damaged.
    """
    file = folder / "train.csv"
    try:
        with file.open(encoding="utf-8", newline="") as lines:
            rows = [
                {key: float(value) for key, value in row.items()} for row in csv.DictReader(lines)
            ]
    except (OSError, TypeError, ValueError) as error:
        raise SdfgcnError(f"{file} cannot be read ({error}); give a training's folder.") from error
    if not rows:
        raise SdfgcnError(f"{file} has no rows yet; wait for `train.log_pushes` pushes.")
    return rows


def spaced(rows: list[Row], count: int) -> list[Row]:
    """At most `count` rows, nearest to evenly spaced times; the last row is included."""
    times = [rows[-1]["seconds"] * (i + 1) / count for i in range(count)]
    nearest = {min(range(len(rows)), key=lambda k: abs(rows[k]["seconds"] - t)) for t in times}
    return [rows[k] for k in sorted(nearest)]


def markdown(rows: list[Row]) -> str:
    """The rows as a Markdown table."""
    heads = (
        *("minutes", "pushes", "updates", "epsilon", "success", "out of range"),
        *("pushes an episode", "loss"),
    )
    cells = (
        (
            *(decimal(row["seconds"] / 60, digits=0), decimal(row["pushes"], digits=0)),
            *(decimal(row["updates"], digits=0), decimal(row["epsilon"], digits=2)),
            *(percent(row["success_rate"]), percent(row["out_of_range_rate"])),
            *(decimal(row["episode_pushes"], digits=0), decimal(row["loss"], digits=2)),
        )
        for row in rows
    )
    return f"{markdown_table(heads, cells)}\n\n{NOTE}\n"


def draw(rows: list[Row], file: Path) -> None:
    """Write the whole curve as a picture.

    Raises:
        SdfgcnError: Matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise SdfgcnError(
            "Matplotlib is not installed, and draws the curve; use pip install -e '.[notebooks]'."
        ) from error
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    axes = figure.subplots(1, 2)
    minutes = [row["seconds"] / 60 for row in rows]
    for key, label in (
        *(("success_rate", "success"), ("out_of_range_rate", "out of range")),
        ("epsilon", "epsilon"),
    ):
        axes[0].plot(minutes, [row[key] for row in rows], label=label)
    axes[0].set(xlabel="minutes", ylabel="share", ylim=(0, 1))
    axes[0].legend()
    axes[1].plot(minutes, [row["loss"] for row in rows], label="loss")
    axes[1].set(xlabel="minutes", ylabel="loss", ylim=(0, None))
    with replaced(file) as part:
        figure.savefig(part, dpi=100)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="How a training went.")
    parser.add_argument("name", help="the files' name, such as sdfgcn")
    parser.add_argument("folder", type=Path, help="the training's run folder")
    parser.add_argument("--rows", type=int, default=10, help="of the table")
    given = arguments_of(parser, arguments)
    name = f"{given.name}_curve"

    def make() -> tuple[str, Callable[[Path], None]]:
        rows = read(given.folder)

        def write_others(folder: Path) -> None:
            draw(rows, folder / f"{name}.png")
            source = (given.folder / "train.csv").read_text(encoding="utf-8")
            write_text(folder / f"{name}.csv", source)

        return markdown(spaced(rows, given.rows)), write_others

    return publish(given, name, make)


if __name__ == "__main__":
    sys.exit(main())
