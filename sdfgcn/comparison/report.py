"""The end of a comparison: its table, figures and rows, written beside its jobs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sdfgcn.comparison.figures import draw
from sdfgcn.comparison.plan import Plan
from sdfgcn.comparison.results import read
from sdfgcn.comparison.table import headline, markdown, rows
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import write_json, write_text

_SEED = 0  # of the bootstrap


def write_report(
    plan: Plan,
    folder: Path,
    methods: Sequence[str],
    seeds: Sequence[int],
    out: Path,
    partial: bool = False,
) -> str:
    """Write `<name>.json`, `<name>.md` and the figures.

    Args:
        plan: The experiment.
        folder: The sweep's folder.
        methods: The methods to show.
        seeds: The training seeds to average over.
        out: Where the files go.
        partial: Leave out cells that some method or seed has not finished.

    Returns:
        The table in Markdown.

    Raises:
        SdfgcnError: A cell is missing, unfinished or damaged, or runs do not belong together.
    """
    experiment = plan.experiment
    results = read(experiment, folder, methods, seeds, partial)
    if not results:
        raise SdfgcnError(f"{folder} has no cell that {', '.join(methods)} have all finished.")
    found = rows(experiment, results, np.random.default_rng(_SEED))
    table = markdown(experiment, found)
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{experiment.name}.json", found)
    write_text(out / f"{experiment.name}.md", table)
    trainings = {name: plan.trainings(name) for name in methods}
    trained = {name: path for name, path in trainings.items() if path.exists()}
    if main := headline(experiment, found):
        draw(experiment.name, main, trained, out)
    return table
