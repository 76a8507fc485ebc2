"""Outcomes of methods that play the same scenes, and the hierarchical bootstrap over them.

Two things vary: the training seed and the scene. The bootstrap draws both with
replacement, first the seeds and then the scenes, and draws them alike for all methods that are
compared. Its 95% intervals are percentiles of the redrawn figures. They have limits:

- Where nothing varies, nothing is redrawn: a rate of 0 or 1 has an interval of zero width, and a
  method with one seed an interval for that one network. Wilson's interval (`results.wilson`) is
  the one to state for a rate of 0 or 1.
- From few seeds their spread is underestimated, on average by a third of its variance for three.
- The luck of single episodes, such as from random actions, is counted more than once (Owen 2007,
  "The pigeonhole bootstrap"), so intervals are too wide rather than too narrow if it dominates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sdfgcn.errors import SdfgcnError

Interval = tuple[float, float]
# Maps matrices [..., seeds, scenes] to figures [...].
Statistic = Callable[..., NDArray[np.float64]]

DRAWS = 2000
MIN_DRAWS = 100  # fewer leave at most two draws beyond each end of an interval
_ENDS = (0.025, 0.975)


class Estimate(NamedTuple):
    """A figure with its 95% interval; `percent(*estimate)` of `report.py` formats it."""

    value: float
    ci95: Interval


@dataclass(frozen=True, eq=False)
class Outcomes:
    """How the episodes of one method ended in one cell, such as a number of objects.

    Column e is the same scene for all seeds and for all methods in this cell.

    Attributes:
        success: Whether the episode succeeded [seeds, scenes], bool.
        pushes: Pushes taken [seeds, scenes].
        error_mm: Final distance to the goal, mean over objects [seeds, scenes], millimetres.
        limit: Most pushes that an episode may take.

    Raises:
        SdfgcnError: The matrices do not fit each other, are empty, or exceed the limit.
    """

    success: NDArray[np.bool_]
    pushes: NDArray[np.integer]
    error_mm: NDArray[np.floating]
    limit: int

    def __post_init__(self) -> None:
        shapes = [matrix.shape for matrix in (self.success, self.pushes, self.error_mm)]
        if len(set(shapes)) > 1 or self.success.ndim != 2 or self.success.size == 0:
            told = ", ".join(map(str, shapes))
            raise SdfgcnError(
                f"success, pushes and error_mm have the shapes {told}; use one shape for all "
                "three, (seeds, scenes), each at least 1."
            )
        if self.success.dtype != np.bool_:
            raise SdfgcnError(f"success holds {self.success.dtype}; use booleans.")
        if self.pushes.min() < 0 or self.pushes.max() > self.limit:
            raise SdfgcnError(
                f"Episodes took {self.pushes.min()} to {self.pushes.max()} pushes; with the limit "
                f"{self.limit} use 0 to {self.limit}."
            )
        if not np.isfinite(self.error_mm).all():
            wrong = self.error_mm[~np.isfinite(self.error_mm)][0]
            raise SdfgcnError(f"error_mm holds {wrong}; use millimetres, of failures too.")


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """Draws of seeds and scenes, made once for all methods that are compared.

    Methods with the same number of seeds share the draws of seeds; all share those of scenes.

    Attributes:
        seeds: Indices of seeds [draws, seeds], by the number of seeds.
        scenes: Indices of scenes [draws, scenes].
    """

    seeds: Mapping[int, NDArray[np.int64]]
    scenes: NDArray[np.int64]

    @classmethod
    def draw(
        cls, rng: np.random.Generator, compared: Sequence[Outcomes], draws: int = DRAWS
    ) -> Bootstrap:
        """Draw for the methods compared in one cell; their order makes no difference.

        Args:
            rng: Source of randomness.
            compared: The outcomes of each method, at least one, on the same scenes.
            draws: Number of draws, at least 100.

        Raises:
            SdfgcnError: There is nothing to compare, the scenes differ in number, or there are
                too few draws.
        """
        scenes = {outcomes.success.shape[1] for outcomes in compared}
        if len(scenes) != 1:
            raise SdfgcnError(
                f"The methods compared played {sorted(scenes) or 'no'} scenes; compare at least "
                "one method, and only methods that played the same scenes."
            )
        check_draws(draws)
        drawn = _drawn(rng, draws, scenes.pop())
        sizes = sorted({outcomes.success.shape[0] for outcomes in compared})
        return cls({size: _drawn(rng, draws, size) for size in sizes}, drawn)

    def resample(self, matrix: NDArray[Any]) -> NDArray[Any]:
        """Return a matrix [seeds, scenes] as each draw has it [draws, seeds, scenes].

        Raises:
            SdfgcnError: The draws are not for a matrix of this shape.
        """
        n_seeds, n_scenes = matrix.shape
        if n_seeds not in self.seeds or n_scenes != self.scenes.shape[1]:
            raise SdfgcnError(
                f"The matrix has {n_seeds} seeds and {n_scenes} scenes, the draws have "
                f"{sorted(self.seeds)} and {self.scenes.shape[1]}; draw with all methods that are "
                "compared."
            )
        return matrix[self.seeds[n_seeds][:, :, None], self.scenes[:, None, :]]

    def estimate(self, statistic: Statistic, *matrices: NDArray[Any]) -> Estimate:
        """Return a statistic of matrices [seeds, scenes], and its interval.

        Args:
            statistic: Maps the matrices, each [..., seeds, scenes], to a figure [...].
            *matrices: Of one method or several.
        """
        redrawn = statistic(*map(self.resample, matrices))
        return Estimate(float(statistic(*matrices)), interval(redrawn))


def check_draws(draws: int) -> None:
    """Refuse too few draws.

    Raises:
        SdfgcnError: There are fewer than 100.
    """
    if draws < MIN_DRAWS:
        raise SdfgcnError(f"An interval from {draws} draws says little; use {MIN_DRAWS} or more.")


def _drawn(rng: np.random.Generator, draws: int, size: int) -> NDArray[np.int64]:
    return rng.integers(size, size=(draws, size))


def percentiles(redrawn: NDArray[Any]) -> NDArray[np.float64]:
    """Return 95% intervals [..., 2] of redrawn figures [draws, ...]."""
    return np.moveaxis(np.quantile(redrawn, _ENDS, axis=0), 0, -1)


def interval(redrawn: NDArray[Any]) -> Interval:
    """Return the 95% interval of one redrawn figure [draws]."""
    low, high = percentiles(redrawn)
    return float(low), float(high)
