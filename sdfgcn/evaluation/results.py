"""Results of an evaluation, with confidence intervals, from its episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.evaluation.episodes import EpisodeResult
from sdfgcn.provenance import provenance

# What `results.json` repeats of a policy's metadata.
_TRAINING = ("seed", "budget", "spent", "git", "training")


def summarise(config: Config, episodes: Sequence[EpisodeResult], wall_s: float) -> dict[str, Any]:
    """Summarise an evaluation of at least one episode: the content of `results.json`.

    Pushes and error are means over successful episodes only, as in the paper. Intervals are 95%
    confidence intervals: Wilson's for the success rate, Student's t for means, cut at what is
    possible: an episode has no more pushes than its limit, and a success no larger error than the
    threshold. A figure that does not exist is None, such as the error if no episode succeeded.
    """
    limit = float(config.env.pushes_per_object * config.env.n_objects)
    threshold_mm = 1000 * config.env.success_threshold
    successes = [episode for episode in episodes if episode.success]
    pushes = [float(episode.pushes) for episode in successes]
    errors = [episode.error_mm for episode in successes]
    return {
        **_network(config),
        "env": config.env.name,
        "objects": config.env.objects.name,
        "split": config.env.split,
        "n_objects": config.env.n_objects,
        "robot": config.env.robot.name,
        "scenario": config.env.scenario.name,
        "success_threshold": config.env.success_threshold,
        "perception": config.env.perception.name,
        "checkpoint": config.checkpoint,
        "epsilon": config.eval.epsilon,
        "loop_distance": config.eval.loop_distance,
        "seed": config.seed,
        "eval_seed": config.eval.seed,
        "episodes": len(episodes),
        "success_rate": len(successes) / len(episodes),
        "success_rate_ci95": wilson(len(successes), len(episodes)),
        "pushes": mean(pushes),
        "pushes_ci95": t_interval(pushes, most=limit),
        "error_mm": mean(errors),
        "error_mm_ci95": t_interval(errors, most=threshold_mm),
        "out_of_range_rate": mean([float(episode.out_of_range) for episode in episodes]),
        "truncated_rate": mean([float(episode.truncated) for episode in episodes]),
        "episode_seeds": [episode.seed for episode in episodes],
        **provenance(),
        "wall_s": wall_s,
    }


def _network(config: Config) -> dict[str, Any]:
    """The model and, if its policy records it, how its network was trained."""
    about: dict[str, Any] = {}
    if config.checkpoint is not None and isinstance(config.model, QNetworkConfig):
        from sdfgcn.agents.policy import find_policy, read_about  # loads torch

        about = read_about(find_policy(config.checkpoint))
    training = about.get("training", {})
    return {
        "model": about.get("model", {}).get("name", config.model.name),
        "curriculum": training.get("curriculum.name"),
        "trained_objects": training.get("n_objects"),
        # Its seed, budget, commit and config; policies of before have no `spent`.
        "training": {key: about[key] for key in _TRAINING} if "spent" in about else None,
    }


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the Wilson 95% confidence interval of a success rate."""
    from scipy import stats  # takes a second to load

    interval = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    return float(interval.low), float(interval.high)


def mean(values: Sequence[float]) -> float | None:
    """Return the mean, or None if there are no values."""
    return sum(values) / len(values) if values else None


def t_interval(values: Sequence[float], most: float = math.inf) -> tuple[float, float] | None:
    """Return Student's t 95% confidence interval of the mean; None for fewer than two values.

    Args:
        values: Each from 0 to `most`.
        most: The largest possible value; the interval is cut at 0 and there.
    """
    if len(values) < 2:
        return None
    from scipy import stats

    middle = sum(values) / len(values)
    half = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    return max(0.0, middle - half), min(most, middle + half)
