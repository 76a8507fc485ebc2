"""The rows of a comparison, with intervals over seeds and scenes, as JSON and Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from sdfgcn.comparison.plan import Cell, cell_name, cells
from sdfgcn.comparison.results import Result
from sdfgcn.config import ComparisonConfig
from sdfgcn.evaluation.bootstrap import Bootstrap
from sdfgcn.evaluation.report import commit_of, decimal, markdown_table, paper, percent
from sdfgcn.evaluation.results import wilson
from sdfgcn.evaluation.statistics import (
    difference,
    mean_over_successes,
    mean_pushes,
    probability_of_improvement,
    success_rate,
    success_within,
)

Row = dict[str, Any]

_COLUMNS = ("env", "scenario", "success_threshold", "n_objects", "split")  # where they vary
# What `results.json` says of the conditions.
CONDITIONS = (*_COLUMNS, "perception", "epsilon", "loop_distance")
WITHIN = 25  # points of a curve of success within k pushes


def rows(
    experiment: ComparisonConfig, results: Sequence[Result], rng: np.random.Generator
) -> list[Row]:
    """One row for each method and cell, in JSON types.

    Args:
        experiment: Names the methods with which the others are compared.
        results: Every method in every cell.
        rng: Draws the bootstrap.
    """
    found = []
    for cell in _distinct(result.cell for result in results):
        here = [result for result in results if result.cell == cell]
        bootstrap = Bootstrap.draw(rng, [result.outcomes for result in here])
        references = [result for result in here if result.method in experiment.references]
        found += [_row(result, references, bootstrap, rng) for result in here]
    return found


def _row(
    result: Result,
    references: Sequence[Result],
    bootstrap: Bootstrap,
    rng: np.random.Generator,
) -> Row:
    outcomes, first = result.outcomes, result.runs[0]
    rate = success_rate(outcomes, bootstrap)
    pushes = mean_over_successes(outcomes.pushes, outcomes, bootstrap)
    error = mean_over_successes(outcomes.error_mm, outcomes, bootstrap)
    counted = mean_pushes(outcomes, bootstrap)
    ks = np.unique(np.linspace(1, outcomes.limit, WITHIN).astype(int))
    within, within_ci95 = success_within(outcomes, ks.tolist(), bootstrap)
    return {
        "method": result.method,
        **result.cell,
        **{key: first[key] for key in CONDITIONS},
        "seeds": list(result.seeds),
        "episodes": outcomes.success.size,
        "limit": outcomes.limit,
        "success_rate": rate.value,
        "success_rate_ci95": _rate_interval(rate, outcomes.success),
        "success_rate_by_seed": outcomes.success.mean(axis=1).tolist(),
        "pushes": pushes[0],
        "pushes_ci95": pushes[1],
        "pushes_with_failures": counted.value,
        "pushes_with_failures_ci95": counted.ci95,
        "error_mm": error[0],
        "error_mm_ci95": error[1],
        "out_of_range_rate": result.out_of_range_rate,
        "success_within": {
            "pushes": ks.tolist(),
            "share": within.tolist(),
            "ci95": within_ci95.tolist(),
        },
        "against": {
            other.method: _against(result, other, bootstrap, rng)
            for other in references
            if other.method != result.method
        },
        "paper": paper(first),
        "training": [run.get("training") for run in result.runs],
        "git": first["git"],
        "versions": first["versions"],
    }


def _rate_interval(rate: Any, success: np.ndarray) -> tuple[float, float]:
    """The bootstrap's interval, or Wilson's where all or no episodes succeeded."""
    if 0 < success.sum() < success.size:
        return rate.ci95
    return wilson(int(success.sum()), success.size)


def _against(
    result: Result, other: Result, bootstrap: Bootstrap, rng: np.random.Generator
) -> dict[str, Any]:
    """Success rate minus the other's on the same scenes, and the probability of improvement."""
    gain = difference(result.outcomes, other.outcomes, bootstrap)
    better = probability_of_improvement([result.outcomes], [other.outcomes], rng)
    return {
        "difference": gain.value,
        "difference_ci95": gain.ci95,
        "probability_of_improvement": better.value,
        "probability_of_improvement_ci95": better.ci95,
    }


# ------------------------------------------------------------------ Markdown


def markdown(experiment: ComparisonConfig, found: Sequence[Row]) -> str:
    """The main table beside the paper's, then one of all other conditions."""
    main = headline(experiment, found)
    others = [row for row in found if row not in main]
    parts = [f"**{experiment.title}.**"]
    if main:
        own = _own(main)
        parts = [f"{parts[0]} {_said(main[0], own)}.", _table(experiment, main)]
    if others:
        parts += ["Other conditions:", _table(experiment, others, conditions=True)]
    parts += [_note(found)]
    if missing := [cell for cell in cells(experiment) if not any(_is(row, cell) for row in found)]:
        parts += [f"Not finished: {'; '.join(map(cell_name, missing))}."]
    return "\n\n".join(parts) + "\n"


def headline(experiment: ComparisonConfig, found: Sequence[Row]) -> list[Row]:
    """The rows of the main table."""
    return [row for row in found if _is(row, experiment.headline)]


def _is(row: Row, conditions: Mapping[str, Any]) -> bool:
    return all(row.get(key) == value for key, value in conditions.items())


def _own(found: Sequence[Row]) -> list[str]:
    """The conditions that differ, which are columns."""
    return [key for key in _COLUMNS if len({row[key] for row in found}) > 1]


def _said(row: Row, own: Sequence[str]) -> str:
    """The conditions of evaluation in words, without those that have a column."""
    worlds = [f"{key} {row[key]}" for key in ("env", "scenario") if key not in own]
    told = ", ".join([*worlds, f"perception {row['perception']}", _help(row)])
    return told[:1].upper() + told[1:]


def _help(row: Row) -> str:
    """The help against loops that every agent had."""
    if row["loop_distance"] is not None:
        return f"epsilon {row['epsilon']}, loop-breaker ({1000 * row['loop_distance']:.0f} mm)"
    return f"epsilon {row['epsilon']}, no loop-breaker"


def _table(experiment: ComparisonConfig, found: Sequence[Row], conditions: bool = False) -> str:
    own = _own(found)
    heads = ["method", *(key.replace("_", " ") for key in own)]
    heads += ["perception", "help"] if conditions else []
    heads += ["seeds"]
    for name in ("success rate", "pushes", "error (mm)"):
        heads += [name] if conditions else [name, "paper"]
    heads += ["pushes, failures as the limit", "out of range"]
    heads += [f"success minus {name}" for name in experiment.references]
    return markdown_table(heads, (_cells(row, own, experiment, conditions) for row in found))


def _cells(row: Row, own: Sequence[str], experiment: ComparisonConfig, told: bool) -> list[str]:
    theirs = row["paper"] or {}
    cells = [row["method"], *(str(row[key]) for key in own)]
    cells += [row["perception"], _help(row)] if told else []
    cells += [str(len(row["seeds"]))]
    for key, show in (("success_rate", percent), ("pushes", decimal), ("error_mm", decimal)):
        cells += [show(row[key], row[f"{key}_ci95"])]
        cells += [] if told else [show(theirs.get(key))]
    cells += [decimal(row["pushes_with_failures"], row["pushes_with_failures_ci95"])]
    cells += [percent(row["out_of_range_rate"])]
    for name in experiment.references:
        gain = row["against"].get(name)
        cells += ["-"] if gain is None else [_points(gain["difference"], gain["difference_ci95"])]
    return cells


def _points(value: float, interval: Sequence[float]) -> str:
    low, high = (f"{100 * bound:+.0f}" for bound in interval)
    return f"{100 * value:+.0f} [{low}, {high}]"


def _note(found: Sequence[Row]) -> str:
    episodes = sorted({row["episodes"] // len(row["seeds"]) for row in found})
    limits = sorted({row["limit"] for row in found})
    return (
        f"Each seed plays the same {_listed(episodes)} scenes; most pushes: {_listed(limits)}. "
        "In brackets: 95% intervals from a bootstrap over training seeds, then scenes (Wilson's at "
        "0% and 100%); none from fewer than 10 successes. Pushes and error are means over "
        "successful episodes, as in the paper. Differences are percentage points on the same "
        f"scenes. The paper's figures are for ShapeNet models. Commit "
        f"{commit_of(found[0]['git'])}."
    )


def _listed(values: Iterable[int]) -> str:
    return ", ".join(map(str, values))


def _distinct(cells: Iterable[Cell]) -> list[Cell]:
    found: list[Cell] = []
    for cell in cells:
        if cell not in found:
            found.append(cell)
    return found
