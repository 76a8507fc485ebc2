"""The figures of a contest between methods, each with its 95% interval.

A method is trained with a few seeds, and each of its networks plays the same scenes as those of all
other methods. `bootstrap.py` says what the intervals cover and where not to trust them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.bootstrap import (
    DRAWS,
    Bootstrap,
    Estimate,
    Interval,
    Outcomes,
    check_draws,
    interval,
    percentiles,
)

MIN_SUCCESSES = 10  # fewer give no interval of a mean over successes


# ------------------------------------------------------------------ success


def success_rate(outcomes: Outcomes, bootstrap: Bootstrap) -> Estimate:
    """Return the success rate over all seeds and scenes."""
    return bootstrap.estimate(_mean, outcomes.success)


def difference(a: Outcomes, b: Outcomes, bootstrap: Bootstrap) -> Estimate:
    """Return the success rate of `a` minus that of `b` on the same scenes.

    What both methods find easy or hard cancels out, so that the interval can exclude 0 although
    those of the two rates overlap.
    """
    return bootstrap.estimate(lambda x, y: _mean(x) - _mean(y), a.success, b.success)


def success_within(
    outcomes: Outcomes, ks: Sequence[int], bootstrap: Bootstrap
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the share of episodes that succeeded within k pushes, for each k.

    Returns:
        The shares [len(ks)], and the interval of each [len(ks), 2].
    """
    needed = _needed(outcomes)
    redrawn = bootstrap.resample(needed)
    shares = np.array([_mean(needed <= k) for k in ks])
    return shares, percentiles(np.stack([_mean(redrawn <= k) for k in ks], axis=-1))


def _needed(outcomes: Outcomes) -> NDArray[np.float64]:
    """Pushes until success, infinite for a failure [seeds, scenes]."""
    return np.where(outcomes.success, outcomes.pushes, np.inf)


def _mean(matrices: NDArray[Any]) -> NDArray[np.float64]:
    return matrices.mean(axis=(-2, -1))


# ------------------------------------------------------------------ pushes and error


def mean_pushes(outcomes: Outcomes, bootstrap: Bootstrap) -> Estimate:
    """Return the mean pushes over all episodes, where a failure counts as the limit.

    Unlike a mean over successes it does not improve as a method gives up hard scenes.
    """
    counted = np.where(outcomes.success, outcomes.pushes, outcomes.limit)
    return bootstrap.estimate(_mean, counted)


def mean_over_successes(
    values: NDArray[Any], outcomes: Outcomes, bootstrap: Bootstrap
) -> tuple[float | None, Interval | None]:
    """Return the mean of pushes or error over successful episodes, as in the paper.

    Draws without a success are left out.

    Args:
        values: `outcomes.pushes` or `outcomes.error_mm` [seeds, scenes].
        outcomes: Say which episodes succeeded.
        bootstrap: The draws.

    Returns:
        The mean, None without a success, and its interval, None from fewer than 10 successes.
    """
    success = outcomes.success
    if not success.any():
        return None, None
    value = float(values[success].mean())
    if success.sum() < MIN_SUCCESSES:
        return value, None
    counts = bootstrap.resample(success).sum(axis=(1, 2))
    sums = bootstrap.resample(np.where(success, values, 0)).sum(axis=(1, 2))
    some = counts > 0
    return value, interval(sums[some] / counts[some])


# ------------------------------------------------------------------ which is better


def probability_of_improvement(
    a: Sequence[Outcomes],
    b: Sequence[Outcomes],
    rng: np.random.Generator,
    draws: int = DRAWS,
    *,
    same_networks: bool = False,
) -> Estimate:
    """Return the probability that a training of `a` beats a training of `b` (Agarwal et al. 2021).

    A training's score is its success rate in a cell. Over all pairs of a seed of `a` and a seed of
    `b`, this is the share in which `a` scores higher, plus half of the ties, averaged over the
    cells. It asks how often `a` is better, not by how much. Of two methods with one seed each it
    can only be 0, 1/2 or 1 in a cell: `share_of_scenes_won` compares these.

    The interval is from new draws of seeds and scenes in each cell; that of rliable, the library of
    Agarwal et al., is from seeds only.

    Args:
        a: Outcomes of the first method in each cell.
        b: Outcomes of the second method in the same cells, on the same scenes.
        rng: Source of randomness.
        draws: Number of draws, at least 100.
        same_networks: Seed s is the same network in all cells, so draw the seeds once for all.

    Raises:
        SdfgcnError: The methods do not have the same cells or scenes, or draws are too few.
    """
    if len(a) != len(b) or not a:
        raise SdfgcnError(
            f"The methods have {len(a)} and {len(b)} cells; compare them in the same cells, at "
            "least one."
        )
    values, redrawn = [], []
    first: Bootstrap | None = None
    for x, y in zip(a, b, strict=True):
        bootstrap = Bootstrap.draw(rng, (x, y), draws)
        first = first or bootstrap
        if same_networks:
            bootstrap = replace(bootstrap, seeds=first.seeds)
        values.append(_seeds_won(x.success, y.success))
        redrawn.append(_seeds_won(bootstrap.resample(x.success), bootstrap.resample(y.success)))
    return Estimate(float(np.mean(values)), interval(np.mean(redrawn, axis=0)))


def share_of_scenes_won(
    a: Outcomes, b: Outcomes, bootstrap: Bootstrap, *, fewer_pushes_win: bool = False
) -> Estimate:
    """Return the share of scenes on which `a` does better than `b`, plus half of the ties.

    It is the mean over all pairs of a seed of `a` and a seed of `b`, each pair compared scene by
    scene, and so makes sense of one seed each. It is not the probability of improvement, which
    compares whole trainings: a method that wins a few more scenes with every seed has a share just
    above 1/2 and a probability of improvement of 1.

    Args:
        a: Outcomes of the first method.
        b: Outcomes of the second method on the same scenes.
        bootstrap: The draws.
        fewer_pushes_win: Of two successes, the one with fewer pushes is better. Otherwise they tie,
            and the share is exactly 1/2 plus half of the `difference`.
    """
    if fewer_pushes_win:
        return bootstrap.estimate(_scenes_won, -_needed(a), -_needed(b))
    return bootstrap.estimate(_scenes_won, a.success, b.success)


def _seeds_won(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.float64]:
    scores_a, scores_b = a.mean(axis=-1), b.mean(axis=-1)
    return _won(scores_a[..., :, None], scores_b[..., None, :], axes=(-2, -1))


def _scenes_won(a: NDArray[Any], b: NDArray[Any]) -> NDArray[np.float64]:
    return _won(a[..., :, None, :], b[..., None, :, :], axes=(-3, -2, -1))


def _won(a: NDArray[Any], b: NDArray[Any], axes: tuple[int, ...]) -> NDArray[np.float64]:
    return (a > b).mean(axis=axes) + (a == b).mean(axis=axes) / 2


# ------------------------------------------------------------------ all cells in one figure


def seed_scores(cells: Sequence[Outcomes]) -> NDArray[np.float64]:
    """Return the success rate of each seed of one method in each cell [seeds, cells].

    Raises:
        SdfgcnError: There is no cell, or the cells differ in the number of seeds.
    """
    sizes = [outcomes.success.shape[0] for outcomes in cells]
    if len(set(sizes)) != 1:
        raise SdfgcnError(f"The cells have {sizes} seeds; use at least one cell, all of one size.")
    return np.stack([outcomes.success.mean(axis=1) for outcomes in cells], axis=1)


def interquartile_mean(
    scores: NDArray[np.float64],
    rng: np.random.Generator,
    draws: int = DRAWS,
    *,
    same_networks: bool = False,
) -> Estimate:
    """Return the mean of the middle half of all scores, pooled (Agarwal et al. 2021).

    The bootstrap is stratified as in rliable: seeds are drawn with replacement within each cell,
    and the cells stay. Scenes are not redrawn, and one seed gives an interval of zero width.

    Args:
        scores: A score for each training and cell [seeds, cells], as of `seed_scores`.
        rng: Source of randomness.
        draws: Number of draws, at least 100.
        same_networks: Seed s is the same network in all cells, so draw the seeds once for all.
            A network that is good in one cell is often good in all, which independent draws average
            out, so that their interval is too narrow.

    Raises:
        SdfgcnError: The scores are no matrix or empty, or draws are too few.
    """
    if scores.ndim != 2 or scores.size == 0:
        raise SdfgcnError(
            f"The scores have the shape {scores.shape}; use (seeds, cells), each at least 1."
        )
    check_draws(draws)
    n_seeds, n_cells = scores.shape
    drawn = rng.integers(n_seeds, size=(draws, n_seeds, 1 if same_networks else n_cells))
    redrawn = scores[drawn, np.arange(n_cells)]
    value = float(_middle_mean(scores.reshape(1, -1))[0])
    return Estimate(value, interval(_middle_mean(redrawn.reshape(draws, -1))))


def _middle_mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    from scipy import stats  # takes a second to load

    return stats.trim_mean(values, 0.25, axis=1)
