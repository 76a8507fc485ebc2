"""Results beside the paper's: the row that a run prints, and tables of many runs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sdfgcn.evaluation.paper import MODELS, paper_figure

Results = Mapping[str, Any]  # the content of `results.json`
Interval = Sequence[float]

# Conditions that the rows of a table may share. Those that differ become columns; the others are
# stated once above the table, unless they are None for every row.
SHARED = (
    *("model", "env", "split", "scenario", "perception", "checkpoint", "curriculum"),
    *("epsilon", "loop_distance", "eval_seed"),
)
_OWN = ("n_objects", "objects", "robot", "seed")  # conditions that always have a column
_THRESHOLD = 0.05  # m, the paper's; named where another one was used
_PRINTED = (
    *("model", "env", "robot", "scenario", "perception", "epsilon", "loop_distance", "seed"),
    "eval_seed",
)
_MEANING = "Pushes and error: means over successes. In brackets: 95% confidence intervals."
_NOTE = (
    "In brackets: 95% confidence intervals (Wilson's for the success rate, Student's t for means). "
    "Pushes and error are means over successful episodes. The paper's figures are for ShapeNet "
    "models, ours for the objects named."
)


def paper(results: Results) -> dict[str, Any] | None:
    """The paper's figure for such a run as a dictionary, or None if it has none."""
    if results["scenario"] != "random" or not _has_paper_threshold(results):
        return None  # the only ones in the paper
    figure = paper_figure(
        *(results[key] for key in ("model", "split", "n_objects")),
        *(results.get(key) for key in ("curriculum", "trained_objects")),
    )
    return None if figure is None else asdict(figure)


def _has_paper_threshold(results: Results) -> bool:
    """Results of before do not name their threshold, which was the paper's."""
    return results.get("success_threshold", _THRESHOLD) == _THRESHOLD


# ------------------------------------------------------------------ cells


def percent(share: float | None, interval: Interval | None = None, digits: int = 0) -> str:
    """Format a share: `93%`, or `93% [90, 95]` with its interval; `-` for None."""
    return _cell(share, interval, 100, digits, "%")


def decimal(value: float | None, interval: Interval | None = None, digits: int = 1) -> str:
    """Format a number: `26.2`, or `26.2 [25.0, 27.3]` with its interval; `-` for None."""
    return _cell(value, interval, 1, digits, "")


def _cell(
    value: float | None, interval: Interval | None, scale: int, digits: int, unit: str
) -> str:
    if value is None:
        return "-"
    bounds = ", ".join(f"{scale * bound:.{digits}f}" for bound in interval or ())
    return f"{scale * value:.{digits}f}{unit}" + (f" [{bounds}]" if bounds else "")


# The figures of a row: key, column heading, format.
_FIGURES: tuple[tuple[str, str, Callable[..., str]], ...] = (
    ("success_rate", "success rate", percent),
    ("pushes", "pushes", decimal),
    ("error_mm", "error (mm)", decimal),
    ("out_of_range_rate", "out of range", percent),
)
_NOT_IN_THE_PAPER = "out_of_range_rate"


def _figures(row: Mapping[str, Any]) -> list[str]:
    return [told(row.get(key), row.get(f"{key}_ci95")) for key, _, told in _FIGURES]


def _said(row: Results, keys: Iterable[str]) -> str:
    """Conditions for a title, such as "epsilon 0.1, no loop distance"."""
    words = ((key.replace("_", " "), row.get(key)) for key in keys)
    return ", ".join(f"no {name}" if value is None else f"{name} {value}" for name, value in words)


# ------------------------------------------------------------------ one run, as text


def text(results: Results, beside: Sequence[Results] = ()) -> str:
    """Format an evaluation (its `results.json`) as an aligned row above those of the paper.

    Args:
        results: The evaluation.
        beside: Evaluations of other agents under the same conditions, a row each.
    """
    rows = [
        ["", "episodes", *(head for _, head, _ in _FIGURES)],
        [f"{results['model']} (this run)", str(results["episodes"]), *_figures(results)],
    ]
    for other in beside:
        rows.append([f"{other['model']} (same scenes)", str(other["episodes"]), *_figures(other)])
    told = results
    if results["model"] not in MODELS:  # a method of our own stands above the paper's best
        told = {**results, "model": "sdfgcn", "curriculum": "on"}
    for figure in filter(None, map(paper, (told, *beside))):
        episodes = "200" if figure["table"] == "table I" else "-"
        rows.append([f"{figure['method']} (paper, {figure['table']})", episodes, *_figures(figure)])
    named = list(_PRINTED)
    if results["checkpoint"] not in (None, results["model"]):
        named.insert(1, "checkpoint")
    return _below(results, named, rows)


def agents_text(results: Mapping[str, Results]) -> str:
    """Format evaluations of several agents on the same scenes as aligned rows.

    Args:
        results: The `results.json` of each agent, by its title.
    """
    rows = [["", "episodes", *(head for _, head, _ in _FIGURES)]]
    rows += [[name, str(row["episodes"]), *_figures(row)] for name, row in results.items()]
    return _below(next(iter(results.values())), [k for k in _PRINTED if k != "model"], rows)


def _below(results: Results, named: list[str], rows: Sequence[Sequence[str]]) -> str:
    """Rows below the conditions of an evaluation."""
    if not _has_paper_threshold(results):
        named.append("success_threshold")
    objects = f"{results['n_objects']} {results['objects']} objects ({results['split']})"
    return "\n".join(
        [
            f"{objects}, {_said(results, named)}",
            *_aligned(rows),
            _MEANING,
        ]
    )


def _aligned(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """The lines of a table whose columns are as wide as their widest cell."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield "  ".join(map(str.ljust, row, widths)).rstrip()


# ------------------------------------------------------------------ the runs of a sweep, as text


def sweep_text(rows: Sequence[Results]) -> str:
    """Format the runs of a sweep as aligned rows, a column for each condition that differs.

    Args:
        rows: Their `results.json`, with the `overrides` of each.
    """
    conditions = (*SHARED[:1], *_OWN, *SHARED[1:], "success_threshold")
    told = [key for key in conditions if any(row.get(key) is not None for row in rows)]
    told += [] if "loop_distance" in told else ["loop_distance"]  # none of them is worth a word
    differing = [key for key in told if len({row.get(key) for row in rows}) > 1]
    given = [dict(each.partition("=")[::2] for each in row["overrides"] or ()) for row in rows]
    others = [
        key
        for key in dict.fromkeys(key for each in given for key in each)
        if len({each.get(key) for each in given}) > 1
        and key.rpartition(".")[2] not in (*conditions, "name")
    ]
    heads = [key.replace("_", " ") for key in differing] + others
    table = [[*heads, "episodes", *(head for _, head, _ in _FIGURES)]]
    for row, each in zip(rows, given, strict=True):
        cells = [_or_dash(row.get(key)) for key in differing] + [
            _or_dash(each.get(k)) for k in others
        ]
        table.append([*cells, str(row["episodes"]), *_figures(row)])
    title = _said(rows[0], [key for key in told if key not in differing])
    return "\n".join([f"{title[:1].upper()}{title[1:]}", *_aligned(table), _MEANING])


def _or_dash(value: Any) -> str:
    return "-" if value is None else str(value)


# ------------------------------------------------------------------ many runs, as Markdown


def markdown(rows: Sequence[Results]) -> str:
    """Format runs (their `results.json`) as a Markdown table, beside the paper's figures."""
    differing = [key for key in SHARED if len({row.get(key) for row in rows}) > 1]
    shared = [key for key in SHARED if key not in differing and rows[0].get(key) is not None]
    if "loop_distance" not in differing and rows[0].get("loop_distance", 0.0) is None:
        shared.append("loop_distance")  # "no loop distance"; results of before do not name it
    title = _said(rows[0], shared)
    heads = [key.replace("_", " ") for key in (*differing, *_OWN, "episodes")]
    for key, name, _ in _FIGURES:
        heads += [name] if key == _NOT_IN_THE_PAPER else [name, "paper"]
    head = [f"{title[:1].upper()}{title[1:]}.", ""] if title else []
    table = markdown_table(heads, (_cells(row, differing) for row in rows))
    return "\n".join([*head, table, "", f"{_NOTE} {_provenance(rows)}"]) + "\n"


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table without a trailing newline."""
    lines = (heads, ["---"] * len(heads), *rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _cells(row: Results, differing: Sequence[str]) -> list[str]:
    cells = [_or_dash(row.get(key)) for key in differing]
    cells += [str(row[key]) for key in (*_OWN, "episodes")]
    figures = zip(_FIGURES, _figures(row), _figures(paper(row) or {}), strict=True)
    for (key, _, _), ours, theirs in figures:
        cells += [ours] if key == _NOT_IN_THE_PAPER else [ours, theirs]
    return cells


def _provenance(rows: Sequence[Results]) -> str:
    """The paper's tables and methods, and the commits and MuJoCo versions behind the rows."""
    figures = [figure for row in rows if (figure := paper(row))]
    tables = sorted({figure["table"] for figure in figures})
    methods = sorted({figure["method"] for figure in figures} - {row["model"] for row in rows})
    commits = sorted({commit_of(row["git"]) for row in rows})
    mujoco = sorted({row["versions"].get("mujoco", "unknown") for row in rows})
    which = f" ({', '.join(methods)})" if methods else ""
    paper_part = f"Paper: {' and '.join(tables)}{which}. " if tables else ""
    return f"{paper_part}Commit {' and '.join(commits)}; MuJoCo {' and '.join(mujoco)}."


def commit_of(git: Mapping[str, Any] | None) -> str:
    """Format a commit for a table; `git` is as in `results.json`."""
    if git is None:
        return "unknown"
    return git["commit"][:10] + (" with uncommitted changes" if git["dirty"] else "")
