from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.bootstrap import Bootstrap, Outcomes, interval, percentiles
from sdfgcn.evaluation.report import decimal, percent
from sdfgcn.evaluation.results import wilson
from sdfgcn.evaluation.statistics import (
    difference,
    interquartile_mean,
    mean_over_successes,
    mean_pushes,
    probability_of_improvement,
    seed_scores,
    share_of_scenes_won,
    success_rate,
    success_within,
)

LIMIT = 20


def outcomes(success: ArrayLike, pushes: ArrayLike = 5, error_mm: ArrayLike = 10.0) -> Outcomes:
    won = np.array(success, dtype=bool)
    return Outcomes(
        won, np.broadcast_to(pushes, won.shape), np.broadcast_to(error_mm, won.shape), LIMIT
    )


def draw(*compared: Outcomes, draws: int = 2000, seed: int = 0) -> Bootstrap:
    return Bootstrap.draw(np.random.default_rng(seed), compared, draws)


def chances(rates: ArrayLike, shape: tuple[int, int], seed: int = 0) -> Outcomes:
    return outcomes(np.random.default_rng(seed).random(shape) < np.asarray(rates))


def rows(*wins: int, scenes: int = 100) -> Outcomes:
    """One seed for each number of scenes won, the first ones."""
    return outcomes([[True] * won + [False] * (scenes - won) for won in wins])


def every_draw(n_seeds: int, n_scenes: int) -> Bootstrap:
    """Each possible draw of seeds and of scenes once, as they are equally likely."""
    seeds = list(itertools.product(range(n_seeds), repeat=n_seeds))
    scenes = list(itertools.product(range(n_scenes), repeat=n_scenes))
    pairs = list(itertools.product(seeds, scenes))
    return Bootstrap(
        {n_seeds: np.array([pair[0] for pair in pairs])}, np.array([pair[1] for pair in pairs])
    )


# ------------------------------------------------------------------ draws


def test_methods_share_draws() -> None:
    a, b, single = outcomes(np.ones((3, 7))), outcomes(np.ones((3, 7))), outcomes(np.ones((1, 7)))
    bootstrap = draw(a, b, single, draws=4000)
    labels = 10 * np.arange(3)[:, None] + np.arange(7)  # tens are the seed, units the scene
    redrawn = bootstrap.resample(labels)
    assert redrawn.shape == (4000, 3, 7)
    seeds, scenes = redrawn // 10, redrawn % 10
    assert (seeds == seeds[:, :, :1]).all()  # a seed keeps its row
    assert (scenes == scenes[:, :1]).all()  # a scene is the same for all seeds
    assert (bootstrap.resample(labels[:1])[:, 0] == scenes[:, 0]).all()  # and for other methods
    # Each with the same chance: a share of p from n draws has a deviation of sqrt(p (1 - p) / n).
    for found, size, n in ((seeds[:, :, 0], 3, 12_000), (scenes[:, 0], 7, 28_000)):
        shares = np.bincount(found.ravel(), minlength=size) / n
        assert shares == pytest.approx(1 / size, abs=4 * np.sqrt((1 - 1 / size) / size / n))


def test_order_of_methods_makes_no_difference() -> None:
    three, one = outcomes(np.ones((3, 5))), outcomes(np.ones((1, 5)))
    labels = np.arange(15).reshape(3, 5)
    first, second = draw(three, one), draw(one, three)
    assert (first.resample(labels) == second.resample(labels)).all()


def test_any_statistic() -> None:
    a = outcomes([[1, 0], [1, 1]], pushes=[[3, 9], [4, 4]])
    best = every_draw(2, 2).estimate(lambda pushes: pushes.min(axis=(-2, -1)), a.pushes)
    # Of 16 draws one has only the 9, a seed 0 in scene 1; the next lower is 4, without seed 0. At
    # 97.5%, 0.975 * 15 = 14.625, it is 0.625 of the way from 4 to 9.
    assert best == (3.0, (3.0, 4 + 0.625 * 5))


def test_percentiles_by_hand() -> None:
    redrawn = np.stack([np.arange(201), 2.0 * np.arange(201)], axis=-1)
    assert percentiles(redrawn) == pytest.approx(np.array([[5, 195], [10, 390]]))
    assert interval(np.arange(201)) == pytest.approx((5, 195))


# ------------------------------------------------------------------ success


def test_success_rate_by_hand() -> None:
    a = outcomes([[1, 1], [1, 0]])
    # Seeds drawn (0, 0), (0, 1), (1, 0), (1, 1), and for each of them scenes in the same order.
    rates = [1, 1, 1, 1, 1, 3 / 4, 3 / 4, 1 / 2, 1, 3 / 4, 3 / 4, 1 / 2, 1, 1 / 2, 1 / 2, 0]
    bootstrap = every_draw(2, 2)
    assert bootstrap.resample(a.success).mean(axis=(1, 2)) == pytest.approx(np.array(rates))
    # At 2.5% of the 16 in order, 0.025 * 15 = 0.375 of the way from the lowest, 0, to 1/2.
    assert success_rate(a, bootstrap) == (0.75, pytest.approx((0.1875, 1.0)))


def test_drawing_agrees_with_every_draw() -> None:
    a = outcomes([[1, 0, 1], [1, 0, 0], [1, 1, 0]])
    exact = every_draw(3, 3).resample(a.success).mean(axis=(1, 2))
    drawn = draw(a, draws=20_000).resample(a.success).mean(axis=(1, 2))
    for rate in range(10):
        share = (exact < (rate + 0.5) / 9).mean()
        assert (drawn < (rate + 0.5) / 9).mean() == pytest.approx(share, abs=0.015)


@pytest.mark.parametrize("won", [False, True])
def test_all_equal_has_no_width(won: bool) -> None:
    a = outcomes(np.full((3, 20), won), pushes=7, error_mm=12.5)
    bootstrap = draw(a)
    assert success_rate(a, bootstrap) == (won, (won, won))
    pushes = 7 if won else LIMIT
    assert mean_pushes(a, bootstrap) == (pushes, (pushes, pushes))
    expected = (12.5, (12.5, 12.5)) if won else (None, None)
    assert mean_over_successes(a.error_mm, a, bootstrap) == expected


def test_seeds_that_differ() -> None:
    a = outcomes([[1] * 50, [1] * 50, [1] * 50, [0] * 50])
    bootstrap = draw(a, draws=20_000)
    redrawn = bootstrap.resample(a.success).mean(axis=(1, 2))
    # Seeds won in a draw: binomial with n = 4, p = 3/4, so a deviation of sqrt(p (1 - p) / n).
    assert redrawn.std() == pytest.approx(np.sqrt(3 / 16 / 4), rel=0.03)
    # None is won in 1 of 256 draws and one in 12 of 256, together 5%; all in 81 of 256.
    assert success_rate(a, bootstrap) == (0.75, (0.25, 1.0))


def test_scenes_that_differ() -> None:
    a = rows(50, 50, 50)
    redrawn = draw(a, draws=20_000).resample(a.success).mean(axis=(1, 2))
    assert redrawn.std() == pytest.approx(np.sqrt(0.5 * 0.5 / 100), rel=0.03)
    # With one outcome for each scene, three seeds are worth no more than one.
    low, high = success_rate(a, draw(a, draws=20_000)).ci95
    assert (low, high) == pytest.approx(stats.binom.ppf([0.025, 0.975], 100, 0.5) / 100, abs=0.011)


def test_seeds_that_differ_widen_the_interval() -> None:
    def width(a: Outcomes) -> float:
        low, high = success_rate(a, draw(a)).ci95
        return high - low

    shape = (5, 200)
    alike = chances(0.6, shape)
    apart = chances([[0.2], [0.4], [0.6], [0.8], [1.0]], shape)
    low, high = wilson(int(apart.success.sum()), apart.success.size)
    # Wilson's: 2 * 1.96 * sqrt(0.6 * 0.4 / 1000). The rates' variance is 0.08, and of a mean of
    # five 0.08 / 5, which is 67 times that; redrawn, luck adds up to three times Wilson's.
    assert high - low == pytest.approx(2 * 1.96 * np.sqrt(0.24 / 1000), rel=0.05)
    assert width(apart) == pytest.approx(2 * 1.96 * np.sqrt(0.08 / 5), rel=0.1)
    assert high - low < width(alike) < 1.1 * np.sqrt(3) * (high - low)


def test_interval_covers_the_truth() -> None:
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(200):
        skill, ease = rng.normal(size=(10, 1)), rng.normal(size=(1, 40))
        # P(skill + ease + luck > 0) is 1/2, as each is symmetric around 0.
        a = outcomes(skill + ease + rng.normal(size=(10, 40)) > 0)
        low, high = success_rate(a, Bootstrap.draw(rng, [a], 400)).ci95
        covered += low <= 0.5 <= high
    # 95% of 200 are 190, with a deviation of 3; ten seeds let a little be missed.
    assert 176 <= covered <= 198


# ------------------------------------------------------------------ difference


def test_a_method_does_not_differ_from_itself() -> None:
    a = chances(0.5, (3, 50))
    bootstrap = draw(a)
    low, high = success_rate(a, bootstrap).ci95
    assert high - low > 0.15
    assert difference(a, a, bootstrap) == (0.0, (0.0, 0.0))
    assert share_of_scenes_won(a, a, bootstrap).value == 0.5
    assert probability_of_improvement([a], [a], np.random.default_rng(0)) == (0.5, (0.5, 0.5))


def test_scenes_cancel_between_other_numbers_of_seeds() -> None:
    many, single = rows(50, 50, 50), rows(50)
    assert difference(many, single, draw(many, single)) == (0.0, (0.0, 0.0))


def test_difference_by_hand() -> None:
    a, b = outcomes([[1, 1, 0]]), outcomes([[0, 1, 0]])
    # Only scene 0 differs. Of 27 draws 8 lack it, 1 has it three times.
    bootstrap = every_draw(1, 3)
    redrawn = bootstrap.resample(a.success).sum((1, 2)) - bootstrap.resample(b.success).sum((1, 2))
    assert np.bincount(redrawn).tolist() == [8, 12, 6, 1]
    found = difference(a, b, bootstrap)
    assert found.value == pytest.approx(1 / 3)
    # At 97.5%, 0.975 * 26 = 25.35, it is 0.35 of the way from the last 2/3 to the only 1.
    assert found.ci95 == pytest.approx((0, 2 / 3 + 0.35 / 3))


def test_pairs_are_closer_than_rates() -> None:
    a, b = rows(60), rows(50)  # b's scenes and ten more
    bootstrap = draw(a, b)
    assert success_rate(b, bootstrap).ci95[1] > success_rate(a, bootstrap).ci95[0]
    low, high = difference(a, b, bootstrap).ci95
    # Ten of a hundred scenes differ: a deviation of sqrt(0.1 * 0.9 / 100) = 0.03.
    assert low == pytest.approx(0.1 - 1.96 * 0.03, abs=0.015)
    assert high == pytest.approx(0.1 + 1.96 * 0.03, abs=0.015)


# ------------------------------------------------------------------ pushes and error


def test_success_within_by_hand() -> None:
    a = outcomes([[1, 1, 0, 1]], pushes=[[2, 4, 3, 20]])
    bootstrap = every_draw(1, 4)
    shares, intervals = success_within(a, [1, 2, 4, 19, 20], bootstrap)
    assert shares.tolist() == [0.0, 0.25, 0.5, 0.5, 0.75]
    assert intervals.shape == (5, 2)
    # Of 256 draws 81 lack a certain scene, 12 have it three times and 1 four times; of those with
    # three certain scenes 81 have no other, 12 have another three times and 1 four times.
    assert intervals[[0, 1, 4]].tolist() == [[0, 0], [0, 0.75], [0.25, 1]]
    assert tuple(intervals[4]) == success_rate(a, bootstrap).ci95  # 20 is the limit


def test_a_failure_counts_as_the_limit() -> None:
    a = outcomes([[1, 0], [1, 0]], pushes=[[4, 7], [6, 20]])
    mean, (low, high) = mean_pushes(a, every_draw(2, 2))
    assert mean == (4 + 20 + 6 + 20) / 4
    # 16 draws: the lowest is seed 0 and scene 0 twice, 4, then mixed seeds, 5; the highest is 20.
    assert (low, high) == pytest.approx((4 + 0.375, 20))


def test_means_over_successes() -> None:
    won = np.arange(40).reshape(2, 20) % 2 == 0  # 20 successes
    pushes = np.where(won, 6, 19)
    a = outcomes(won, pushes, error_mm=np.where(won, [[10.0], [30.0]], 500.0))
    bootstrap = draw(a)
    assert mean_over_successes(a.pushes, a, bootstrap) == (6.0, (6.0, 6.0))
    # A seed is drawn twice in a quarter of the draws: 10 or 30, otherwise 20.
    mean, bounds = mean_over_successes(a.error_mm, a, bootstrap)
    assert (mean, bounds) == (20.0, pytest.approx((10.0, 30.0)))
    assert decimal(mean, bounds) == "20.0 [10.0, 30.0]"


@pytest.mark.parametrize("n", [0, 1, 9, 10])
def test_few_successes_give_no_interval(n: int) -> None:
    a = outcomes([[True] * n + [False] * (30 - n)], error_mm=np.arange(30.0))
    mean, bounds = mean_over_successes(a.error_mm, a, draw(a))
    assert mean == (None if n == 0 else (n - 1) / 2)
    assert (bounds is not None) == (n == 10)
    assert decimal(mean, bounds).count("[") == (n == 10)


def test_draws_without_a_success_are_left_out() -> None:
    a = outcomes([[1] * 12, [0] * 12, [0] * 12], error_mm=15.0)
    # 8 of 27 draws lack seed 0.
    assert mean_over_successes(a.error_mm, a, draw(a)) == (15.0, (15.0, 15.0))


# ------------------------------------------------------------------ which is better


def rliable_improvement(x: NDArray[Any], y: NDArray[Any]) -> float:
    """Mann-Whitney's U over the number of pairs, averaged over tasks; x, y are [runs, tasks]."""
    shares = [
        stats.mannwhitneyu(one, other).statistic / (len(one) * len(other))
        for one, other in zip(x.T, y.T, strict=True)
    ]
    return float(np.mean(shares))


def cells_of(*scores: Sequence[int]) -> list[Outcomes]:
    """A cell for each row of scores, scenes won of 10 by each seed."""
    return [rows(*row, scenes=10) for row in scores]


def test_probability_of_improvement_by_hand() -> None:
    a, b = cells_of([5, 8]), cells_of([5, 6, 9])
    # 5 against 5, 6, 9: a tie; 8: two wins. So 2.5 of 6 pairs.
    found = probability_of_improvement(a, b, np.random.default_rng(0))
    assert found.value == pytest.approx(2.5 / 6)
    two = probability_of_improvement(a + cells_of([9, 9]), b + cells_of([1, 2, 3]), _rng())
    assert two.value == pytest.approx((2.5 / 6 + 1) / 2)
    reverse = probability_of_improvement(b, a, np.random.default_rng(0))
    assert reverse.value == pytest.approx(1 - 2.5 / 6)
    assert reverse.ci95 == pytest.approx((1 - found.ci95[1], 1 - found.ci95[0]))


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_probability_of_improvement_is_rliables() -> None:
    rng = np.random.default_rng(1)
    for n_a, n_b in ((3, 3), (5, 2), (1, 4)):
        scores_a, scores_b = rng.integers(4, 9, (n_a, 4)), rng.integers(4, 9, (n_b, 4))
        a, b = cells_of(*scores_a.T), cells_of(*scores_b.T)
        found = probability_of_improvement(a, b, rng, draws=100).value
        pairs = scores_a[:, None] - scores_b[None]
        assert found == pytest.approx(((np.sign(pairs) + 1) / 2).mean())
        assert found == pytest.approx(rliable_improvement(scores_a, scores_b))


def test_probability_of_improvement_varies_with_the_seeds() -> None:
    # Every scene is alike, so that only seeds vary: won by 3 of 4 seeds against 2 of 4.
    a, b = rows(10, 10, 10, 0, scenes=10), rows(10, 10, 0, 0, scenes=10)
    low, high = probability_of_improvement([a], [b], _rng(), draws=20_000).ci95
    # Seeds 0 and 1 win for both, 2 only for a, 3 for none, and draws are alike. With shares p of
    # a and q of b the figure is 1/2 + (p - q)/2, and p - q the share of seed 2: binomial, n = 4,
    # p = 1/4. It is 0 in 32% of the draws, above 1/2 in 13 of 256, of which 1 is 1.
    assert (low, high) == pytest.approx((0.5, 0.5 + 0.75 / 2))


def test_same_networks_in_all_cells() -> None:
    # A seed wins all or nothing in every cell, against a rival who wins nothing.
    a, b = [rows(10, 0, scenes=10)] * 4, [rows(0, scenes=10)] * 4
    apart = probability_of_improvement(a, b, _rng(), draws=20_000)
    together = probability_of_improvement(a, b, _rng(), draws=20_000, same_networks=True)
    # A win counts 1 and a tie 1/2. With the same seeds in all cells a quarter of the draws has only
    # ties, a quarter only wins. Drawn for each of four cells, they are eight fair coins: no win has
    # a chance of 1/256, at most one 9/256, and as rare are eight and at least seven.
    assert together == (0.75, (0.5, 1.0))
    assert apart == (0.75, pytest.approx((0.5 + 1 / 16, 1 - 1 / 16)))


def test_interquartile_mean_of_the_same_networks() -> None:
    scores = seed_scores([rows(10, 0, scenes=10)] * 16)
    assert scores.tolist() == [[1.0] * 16, [0.0] * 16]
    assert interquartile_mean(scores, _rng(), same_networks=True) == (0.5, (0.0, 1.0))
    # Drawn for each cell, ones are as heads of 32 coins: 10 or 11 at 2.5%, of which the lowest
    # eight scores cut away none, as they are zeros, and the highest eight cut away eight.
    low, high = interquartile_mean(scores, _rng()).ci95
    assert 2 / 16 <= low <= 3 / 16
    assert 13 / 16 <= high <= 14 / 16


def test_share_of_scenes_by_hand() -> None:
    a = outcomes([[1, 1, 0, 0]], pushes=[[3, 9, 2, 8]])
    b = outcomes([[1, 1, 1, 0]], pushes=[[5, 9, 19, 1]])
    bootstrap = every_draw(1, 4)
    # Ties but for scene 2, which b wins.
    assert share_of_scenes_won(a, b, bootstrap).value == 1.5 / 4
    # Scene 0 goes to a now, in 3 pushes; the pushes of a failure do not count.
    assert share_of_scenes_won(a, b, bootstrap, fewer_pushes_win=True).value == 2 / 4


def test_share_of_scenes_over_pairs_of_seeds() -> None:
    rng = np.random.default_rng(2)
    won_a, won_b = rng.random((3, 8)) < 0.7, rng.random((2, 8)) < 0.4
    taken_a, taken_b = rng.integers(1, 6, (3, 8)), rng.integers(1, 6, (2, 8))
    a, b = outcomes(won_a, taken_a), outcomes(won_b, taken_b)
    points = fewer = 0.0
    for i, j, e in itertools.product(range(3), range(2), range(8)):
        one, other = won_a[i, e], won_b[j, e]
        points += 1.0 if one and not other else 0.5 if one == other else 0.0
        quicker = np.sign(taken_b[j, e] - taken_a[i, e]) if one and other else 0
        fewer += 0.5 * quicker
    bootstrap = draw(a, b)
    found = share_of_scenes_won(a, b, bootstrap)
    assert found.value == pytest.approx(points / 48)
    by_pushes = share_of_scenes_won(a, b, bootstrap, fewer_pushes_win=True)
    assert by_pushes.value == pytest.approx((points + fewer) / 48)
    # As the docstring says, also of the interval.
    apart = difference(a, b, bootstrap)
    assert found.value == pytest.approx(0.5 + apart.value / 2)
    assert found.ci95 == pytest.approx([0.5 + end / 2 for end in apart.ci95])


def test_shares_of_scenes_and_of_trainings_differ() -> None:
    a, b = rows(52, 53, 54), rows(49, 50, 51)
    assert probability_of_improvement([a], [b], np.random.default_rng(0)).value == 1.0
    assert share_of_scenes_won(a, b, draw(a, b)).value == pytest.approx(0.515)


# ------------------------------------------------------------------ all cells in one figure


def test_interquartile_mean_by_hand() -> None:
    scores = np.array([[0.0, 0.1, 0.2, 0.9], [0.3, 0.5, 0.6, 1.0]])
    # Sorted 0, .1, | .2, .3, .5, .6, | .9, 1: the middle four.
    assert interquartile_mean(scores, _rng()).value == pytest.approx(1.6 / 4)
    nine = np.arange(9.0).reshape(3, 3)
    # 25% of 9 are 2.25: two are cut on either side.
    assert interquartile_mean(nine**2, _rng()).value == pytest.approx((4 + 9 + 16 + 25 + 36) / 5)


def test_interquartile_mean_is_rliables() -> None:
    scores = np.random.default_rng(5).random((3, 4))
    value, bounds = interquartile_mean(scores, _rng(), draws=20_000)
    assert value == pytest.approx(stats.trim_mean(scores, 0.25, axis=None))
    # All 27^4 draws of three seeds in each of four cells are too many; independent ones will do.
    rng = np.random.default_rng(6)
    redrawn = []
    for _ in range(4000):
        columns = [scores[rng.choice(3, 3), cell] for cell in range(4)]
        middle = np.sort(np.concatenate(columns))[3:9]
        redrawn.append(middle.mean())
    assert bounds == pytest.approx(np.quantile(redrawn, (0.025, 0.975)), abs=0.02)


def test_cells_are_not_redrawn() -> None:
    # Seeds agree in each cell, so that there is nothing to draw; drawing cells would vary.
    scores = np.tile([0.1, 0.4, 0.6, 0.9], (3, 1))
    found = interquartile_mean(scores, _rng())
    # Three of each: the middle six are .4 and .6.
    assert (found.value, *found.ci95) == pytest.approx((0.5, 0.5, 0.5))


# ------------------------------------------------------------------ errors and formats


def test_formats_as_in_the_reports() -> None:
    a = outcomes([[1] * 50, [1] * 50, [1] * 50, [0] * 50])
    assert percent(*success_rate(a, draw(a, draws=20_000))) == "75% [25, 100]"


@pytest.mark.parametrize(
    ("success", "pushes", "told"),
    [
        (np.ones((2, 3), bool), np.ones((2, 2), int), r"shapes \(2, 3\), \(2, 2\), \(2, 3\)"),
        (np.ones((2, 0), bool), np.ones((2, 0), int), r"shapes \(2, 0\).* each at least 1"),
        (np.ones(4, bool), np.ones(4, int), r"use one shape for all three, \(seeds, scenes\)"),
        (np.ones((2, 3), int), np.ones((2, 3), int), "success holds int64; use booleans"),
        (np.ones((1, 2), bool), np.array([[3, 21]]), r"took 3 to 21 pushes; .* use 0 to 20"),
        (np.ones((1, 2), bool), np.array([[-1, 4]]), r"took -1 to 4 pushes"),
    ],
)
def test_refuses_matrices(success: NDArray[Any], pushes: NDArray[Any], told: str) -> None:
    with pytest.raises(SdfgcnError, match=told):
        Outcomes(success, pushes, np.ones(success.shape), LIMIT)


def test_refuses_an_error_that_is_no_number() -> None:
    with pytest.raises(SdfgcnError, match="error_mm holds nan"):
        outcomes([[1, 0]], error_mm=[[3.0, np.nan]])


def test_refuses_what_cannot_be_compared() -> None:
    two, three = outcomes(np.ones((1, 2))), outcomes(np.ones((3, 3)))
    with pytest.raises(SdfgcnError, match=r"played \[2, 3\] scenes"):
        draw(two, three)
    with pytest.raises(SdfgcnError, match="played no scenes"):
        draw()
    with pytest.raises(SdfgcnError, match="from 50 draws"):
        draw(two, draws=50)
    with pytest.raises(SdfgcnError, match=r"3 seeds and 3 scenes, the draws have \[1\] and 2"):
        success_rate(three, draw(two))
    with pytest.raises(SdfgcnError, match="have 1 and 2 cells"):
        probability_of_improvement([two], [two, two], _rng())
    with pytest.raises(SdfgcnError, match="have 0 and 0 cells"):
        probability_of_improvement([], [], _rng())
    with pytest.raises(SdfgcnError, match=r"have \[1, 3\] seeds"):
        seed_scores([two, three])
    with pytest.raises(SdfgcnError, match=r"shape \(4,\)"):
        interquartile_mean(np.ones(4), _rng())
