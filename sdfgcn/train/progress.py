"""Reports of training progress: a live line, `train.csv` and the run's logger."""

from __future__ import annotations

import csv
import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from sdfgcn.files import CsvTable
from sdfgcn.loggers import Logger
from sdfgcn.progress_bar import progress_bar

WINDOW = 100  # episodes or updates over which metrics are averaged

_COUNTED = ("pushes", "updates", "episodes", "seconds", "pushes_per_s", "updates_per_s")
_OF_EPISODES = ("success_rate", "out_of_range_rate", "episode_pushes", "return")


def columns(metrics: tuple[str, ...] = ("loss",)) -> tuple[str, ...]:
    """The columns of `train.csv`, given the names of the learner's metrics."""
    return (*_COUNTED, *_OF_EPISODES, *metrics, "epsilon", "n_objects")


class Progress:
    """Counts pushes and episodes, averages recent metrics, and shows and logs them."""

    def __init__(
        self, folder: Path, logger: Logger, log_pushes: int, metrics: tuple[str, ...] = ("loss",)
    ) -> None:
        """Start all counters at zero.

        Args:
            folder: The run folder.
            logger: Also receives each row of `train.csv`; its step is the number of pushes.
            log_pushes: Pushes between rows.
            metrics: Names of the learner's metrics; a column each.
        """
        self.pushes = self.episodes = 0
        self._earlier_s = 0.0  # training time before the checkpoint resumed from
        self._began = time.monotonic()
        self._table = CsvTable(folder / "train.csv", columns(metrics))
        self._logger = logger
        self._log_pushes = log_pushes
        self._metrics = metrics
        self._recent = {name: deque[float](maxlen=WINDOW) for name in (*_OF_EPISODES, *metrics)}
        self._return: dict[int, float] = {}  # of unfinished episodes so far, by trajectory
        self._carried = 0.0  # return so far of the checkpoint's unfinished episode
        self._last_row = (self._began, 0, 0)  # time, pushes and updates at the last row

    @property
    def seconds(self) -> float:
        """Wall-clock seconds of training, including time before a restart."""
        return self._earlier_s + time.monotonic() - self._began

    def open(self, updates: int, total: int, minutes: float | None = None) -> None:
        """Show the live line, and drop rows of `train.csv` that will be written again.

        Args:
            updates: Updates so far.
            total: Pushes after which training ends; the line shows the time left until then.
            minutes: Minutes after which training ends if that is sooner; also shown.
        """
        self._minutes = minutes
        self._table.keep(lambda row: int(row["pushes"]) <= self.pushes)
        self._began = time.monotonic()  # excludes the time taken to build the parts
        self._last_row = (self._began, self.pushes, updates)
        self._bar = progress_bar(total=total, initial=self.pushes, unit="push")

    def close(self) -> None:
        """Close the live line."""
        self._bar.close()

    def updated(self, figures: dict[str, float]) -> None:
        """Record the metrics of one update."""
        for name in self._metrics:
            self._recent[name].append(figures[name])

    def pushed(self, collected: TensorDictBase) -> None:
        """Count [T] pushes from a collector, and the episodes that they end."""
        outcome = collected["next"]
        done = outcome["done"].squeeze(-1).tolist()
        rewards = outcome["reward"].squeeze(-1).tolist()
        trajectories = collected["collector", "traj_ids"].tolist()
        for i, trajectory in enumerate(trajectories):
            total = self._return.pop(trajectory, self._carried) + rewards[i]
            self._carried = 0.0
            if not done[i]:
                self._return[trajectory] = total
                continue
            self.episodes += 1
            self._recent["success_rate"].append(float(outcome["success"][i]))
            self._recent["out_of_range_rate"].append(float(outcome["out_of_range"][i]))
            self._recent["episode_pushes"].append(float(outcome["pushes"][i]))
            self._recent["return"].append(total)
        self.pushes += len(trajectories)

    def tell(self, updates: int, epsilon: float, n_objects: int) -> None:
        """Update the live line, and log a row if `log_pushes` pushes have passed since the last.

        Args:
            updates: Updates so far.
            epsilon: Current share of random pushes.
            n_objects: Current largest number of objects in a training episode.
        """
        now, (then, last_pushes, last_updates) = time.monotonic(), self._last_row
        took = max(now - then, 1e-9)
        figures = {
            "pushes": self.pushes,
            "updates": updates,
            "episodes": self.episodes,
            "seconds": round(self.seconds, 1),
            "pushes_per_s": round((self.pushes - last_pushes) / took, 2),
            "updates_per_s": round((updates - last_updates) / took, 3),
            **{name: _mean(values) for name, values in self._recent.items()},
            "epsilon": epsilon,
            "n_objects": n_objects,
        }
        spent = (
            "" if self._minutes is None else f"{self.seconds / 60:.0f} of {self._minutes:g} min, "
        )
        self._bar.set_postfix_str(
            f"{spent}{updates} updates, {figures['updates_per_s']:.1f}/s, "
            f"success {figures['success_rate']:.0%}, "
            + "".join(f"{name} {figures[name]:.3g}, " for name in self._metrics)
            + f"epsilon {epsilon:.2f}, {n_objects} objects",
            refresh=False,
        )
        self._bar.update(self.pushes - self._bar.n)
        if self.pushes // self._log_pushes > last_pushes // self._log_pushes:
            self._table.append({name: _plain(value) for name, value in figures.items()})
            self._logger.log(
                self.pushes, {f"train/{name}": float(value) for name, value in figures.items()}
            )
            self._last_row = (time.monotonic(), self.pushes, updates)

    def state_dict(self) -> dict[str, Any]:
        """The state for a checkpoint."""
        return {
            "counters": [self.pushes, self.episodes],
            "seconds": self.seconds,
            "recent": {name: list(values) for name, values in self._recent.items()},
            "running": sum(self._return.values(), self._carried),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the state from a checkpoint."""
        self.pushes, self.episodes = (int(count) for count in state["counters"])
        self._earlier_s = float(state["seconds"])
        for name, values in self._recent.items():
            values.clear()
            values.extend(map(float, state["recent"][name]))
        self._carried = float(state["running"])

    def forget_episode(self) -> None:
        """Drop the checkpoint's unfinished episode: the collectors start new ones."""
        self._carried = 0.0


def read_curve(file: Path) -> list[dict[str, str]]:
    """The rows of a `train.csv`, whatever its learner's metrics; none if there is no file.

    Raises:
        SdfgcnError: It is not such a table, or a row has too few or too many cells.
    """
    header: list[str] = []
    if file.exists():
        with file.open(encoding="utf-8", newline="") as lines:
            header = next(csv.reader(lines), [])
    own = columns(())
    return CsvTable(file, columns(tuple(name for name in header if name not in own))).read()


def _mean(values: deque[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _plain(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"
