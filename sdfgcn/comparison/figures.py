"""Figures of a comparison, with matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdfgcn.files import replaced
from sdfgcn.train.progress import read_curve

Row = Mapping[str, Any]


def draw(name: str, headline: Sequence[Row], trainings: Mapping[str, Path], folder: Path) -> None:
    """Write `<name>_success.png`, `<name>_within.png` and `<name>_training.png`.

    Args:
        name: The experiment's name.
        headline: The rows of the main table.
        trainings: The folder of each trained method, which holds `seed_*/train.csv`.
        folder: Where the figures go.
    """
    import matplotlib

    matplotlib.use("Agg")
    _save(folder / f"{name}_success.png", _success(headline))
    _save(folder / f"{name}_within.png", _within(headline))
    if curves := {method: _curves(path) for method, path in trainings.items()}:
        _save(folder / f"{name}_training.png", _training(curves))


def _axes(n: int = 1) -> tuple[Any, Any]:
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, n, figsize=(1.0 + 4.2 * n, 4.0), squeeze=False)
    for each in axes[0]:
        each.grid(alpha=0.3)
    return figure, axes[0]


def _save(path: Path, figure: Any) -> None:
    from matplotlib import pyplot

    figure.tight_layout()
    with replaced(path) as part:
        figure.savefig(part, dpi=120)
    pyplot.close(figure)


def _success(rows: Sequence[Row]) -> Any:
    """Success rate by number of objects; by method where there is one number."""
    figure, (axis,) = _axes()
    counts = sorted({row["n_objects"] for row in rows})
    methods = list(dict.fromkeys(row["method"] for row in rows))
    splits = list(dict.fromkeys(row["split"] for row in rows))
    for m, method in enumerate(methods):
        for s, split in enumerate(splits):
            own = [row for row in rows if row["method"] == method and row["split"] == split]
            rate = np.array([row["success_rate"] for row in own])
            reach = np.abs(np.array([row["success_rate_ci95"] for row in own]).T - rate)
            at = np.array([row["n_objects"] for row in own]) + 0.06 * (m - len(methods) / 2)
            if len(counts) == 1:
                at = np.full(len(own), m + 0.2 * (s - (len(splits) - 1) / 2))
            label = method if len(counts) > 1 else (split if m == 0 else None)
            style = "o-" if len(counts) > 1 else "o"
            color = f"C{m}" if len(counts) > 1 else f"C{s}"
            axis.errorbar(at, rate, yerr=reach, fmt=style, color=color, label=label, capsize=3)
    if len(counts) == 1:
        axis.set_xticks(range(len(methods)), methods, rotation=30, ha="right")
    else:
        axis.set_xticks(counts)
        axis.set_xlabel("objects")
    axis.set_ylabel("success rate")
    axis.set_ylim(0.0, 1.02)
    axis.legend(fontsize=8)
    return figure


def _within(rows: Sequence[Row]) -> Any:
    """Share of episodes that succeeded within k pushes, an axis for each number of objects."""
    shown = [row for row in rows if row["split"] == rows[0]["split"]]
    counts = sorted({row["n_objects"] for row in shown})
    figure, axes = _axes(len(counts))
    for axis, count in zip(axes, counts, strict=True):
        for row in (row for row in shown if row["n_objects"] == count):
            curve = row["success_within"]
            low, high = np.array(curve["ci95"]).T
            (line,) = axis.plot(curve["pushes"], curve["share"], label=row["method"])
            axis.fill_between(curve["pushes"], low, high, alpha=0.15, color=line.get_color())
        axis.set_title(f"{count} objects")
        axis.set_xlabel("pushes")
        axis.set_ylim(0.0, 1.02)
    axes[0].set_ylabel("success within so many pushes")
    axes[-1].legend(fontsize=8)
    return figure


def _curves(folder: Path) -> list[tuple[list[int], list[float]]]:
    """Pushes and success rate of each seed's training."""
    curves = []
    for file in sorted(folder.glob("seed_*/train.csv")):
        table = read_curve(file)
        known = [(int(row["pushes"]), row["success_rate"]) for row in table if row["success_rate"]]
        curves.append(([pushes for pushes, _ in known], [float(rate) for _, rate in known]))
    return curves


def _training(curves: Mapping[str, Sequence[tuple[list[int], list[float]]]]) -> Any:
    """Success rate of the last 100 training episodes, a line for each seed."""
    figure, (axis,) = _axes()
    for m, (method, seeds) in enumerate(curves.items()):
        for s, (pushes, rate) in enumerate(seeds):
            axis.plot(pushes, rate, color=f"C{m}", alpha=0.8, label=method if s == 0 else None)
    axis.set_xlabel("pushes of training")
    axis.set_ylabel("success rate, last 100 episodes")
    axis.set_ylim(0.0, 1.02)
    axis.legend(fontsize=8)
    return figure
