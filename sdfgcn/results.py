"""From episodes to the row of a table, with intervals."""

from __future__ import annotations

import json
import platform
import subprocess
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.episodes import Episode
from sdfgcn.paper import PaperFigure, paper_figure

# What a result depends on, besides Python.
_PACKAGES = (
    "sdfgcn",
    "mujoco",
    "dm-control",
    "torch",
    "torchrl",
    "tensordict",
    "numpy",
    "scipy",
    "scikit-fmm",
    "hydra-core",
)
_ROOT = Path(__file__).resolve().parents[1]


def summarise(config: Config, episodes: Sequence[Episode], wall_s: float) -> dict[str, Any]:
    """Summarise an evaluation: the content of `results.json`.

    Pushes and error are means over the successful episodes alone, as in the paper. An interval is
    a 95% confidence interval: Wilson's for the success rate, Student's t for a mean.

    Args:
        config: The whole experiment.
        episodes: Every episode of it; at least one.
        wall_s: Wall seconds that the evaluation took.

    Returns:
        The figures by name; None where there is none, as for the error if nothing succeeded.
    """
    successes = [episode for episode in episodes if episode.success]
    steps = [float(episode.pushes) for episode in successes]
    errors = [episode.error_mm for episode in successes]
    return {
        **_network(config),
        "objects": config.env.objects.name,
        "split": config.env.split,
        "n_objects": config.env.n_objects,
        "robot": config.env.robot.name,
        "scenario": config.env.scenario.name,
        "perception": config.env.perception.name,
        "checkpoint": config.checkpoint,
        "epsilon": config.eval.epsilon if config.checkpoint else None,
        "loop_distance": config.eval.loop_distance if config.checkpoint else None,
        "seed": config.seed,
        "episodes": len(episodes),
        "success_rate": len(successes) / len(episodes),
        "success_rate_ci95": wilson(len(successes), len(episodes)),
        "steps": mean(steps),
        "steps_ci95": t_interval(steps),
        "error_mm": mean(errors),
        "error_mm_ci95": t_interval(errors),
        "out_of_range_rate": mean([float(episode.out_of_range) for episode in episodes]),
        "truncated_rate": mean([float(episode.truncated) for episode in episodes]),
        "episode_seeds": [episode.seed for episode in episodes],
        "versions": versions(),
        "git": git_state(_ROOT),
        "wall_s": wall_s,
    }


def _network(config: Config) -> dict[str, Any]:
    """The model, and how its network had been trained, as far as its policy says so."""
    about: dict[str, Any] = {}
    if config.checkpoint is not None and isinstance(config.model, QNetworkConfig):
        from sdfgcn.agents.policy import ABOUT, find_policy  # loads torch

        file = find_policy(config.checkpoint) / ABOUT
        about = json.loads(file.read_text(encoding="utf-8"))
    training = about.get("training", {})
    return {
        "model": about.get("model", {}).get("name", config.model.name),
        "curriculum": training.get("curriculum.name"),
        "trained_objects": training.get("n_objects"),
    }


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the Wilson 95% confidence interval of a success rate."""
    from statsmodels.stats.proportion import proportion_confint  # loads pandas: seconds

    low, high = proportion_confint(successes, trials, alpha=0.05, method="wilson")
    return float(low), float(high)


def mean(values: Sequence[float]) -> float | None:
    """Return the mean, or None of nothing."""
    return sum(values) / len(values) if values else None


def t_interval(values: Sequence[float]) -> tuple[float, float] | None:
    """Return Student's t 95% confidence interval of a mean, or None of fewer than two values."""
    if len(values) < 2:
        return None
    from statsmodels.stats.weightstats import DescrStatsW

    low, high = DescrStatsW(values).tconfint_mean(alpha=0.05)
    return float(low), float(high)


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a result depends on."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:  # run from the source tree, not installed
            continue
    return found


def git_state(root: Path) -> dict[str, Any] | None:
    """Return the commit that a source tree stands at, and whether its files differ from it.

    Returns:
        `commit` and `dirty`, or None where `root` is not the top of a git checkout.
    """
    top = _git(root, "rev-parse", "--show-toplevel")
    commit = _git(root, "rev-parse", "HEAD")
    if top is None or commit is None or Path(top) != root:
        return None
    return {"commit": commit, "dirty": bool(_git(root, "status", "--porcelain"))}


def _git(root: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def table(results: dict[str, Any]) -> str:
    """Lay out the row of an evaluation above the paper's, aligned.

    Args:
        results: What `summarise` returned.
    """
    rows = [
        ("", "episodes", "success rate", "pushes", "error (mm)", "out of range"),
        (
            f"{results['model']} (this run)",
            str(results["episodes"]),
            _cell(results["success_rate"], results["success_rate_ci95"], percent=True),
            _cell(results["steps"], results["steps_ci95"]),
            _cell(results["error_mm"], results["error_mm_ci95"]),
            _cell(results["out_of_range_rate"], percent=True),
        ),
    ]
    paper = _paper(results)
    if paper is not None:
        rows.append(
            (
                f"{paper.method} (paper, {paper.table})",
                "200" if paper.table == "table I" else "-",
                _cell(paper.success_rate, percent=True),
                _cell(paper.steps),
                _cell(paper.error_mm),
                "-",
            )
        )
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    title = (
        f"{results['n_objects']} {results['objects']} objects ({results['split']}), robot "
        f"{results['robot']}, scenario {results['scenario']}, perception {results['perception']}, "
        f"seed {results['seed']}"
    )
    note = "Pushes and error: means over successes. In brackets: 95% confidence intervals."
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    return "\n".join([title, *lines, note])


def _paper(results: dict[str, Any]) -> PaperFigure | None:
    if results["scenario"] != "random":
        return None
    return paper_figure(
        *(results[key] for key in ("model", "split", "n_objects")),
        *(results.get(key) for key in ("curriculum", "trained_objects")),
    )


def _cell(
    value: float | None, interval: tuple[float, float] | None = None, percent: bool = False
) -> str:
    if value is None:
        return "-"
    scale, unit, digits = (100, "%", 0) if percent else (1, "", 1)
    text = f"{scale * value:.{digits}f}{unit}"
    if interval is None:
        return text
    low, high = (f"{scale * bound:.{digits}f}" for bound in interval)
    return f"{text} [{low}, {high}]"
