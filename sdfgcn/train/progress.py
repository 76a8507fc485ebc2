"""How a training goes: one live line, `train.csv`, and the run's logger."""

from __future__ import annotations

import time
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
from tensordict import TensorDictBase
from tqdm import tqdm

from sdfgcn.files import CsvTable
from sdfgcn.loggers import Logger

WINDOW = 100  # episodes over which success is measured

COLUMNS = (
    *("pushes", "updates", "episodes", "seconds", "pushes_per_s", "updates_per_s"),
    *("success_rate", "out_of_range_rate", "episode_pushes", "return", "loss", "epsilon"),
    "n_objects",
)


class TrainTable:
    """`train.csv`: one row every so many pushes."""

    def __init__(self, path: Path) -> None:
        self._table = CsvTable(path, COLUMNS)

    def cut(self, pushes: int) -> None:
        """Drop the rows after so many pushes: those are done again."""
        self._table.keep(lambda row: int(row["pushes"]) <= pushes)

    def append(self, figures: dict[str, float]) -> None:
        """Add a row; it is in the file when this returns."""
        self._table.append({name: _plain(value) for name, value in figures.items()})


class Progress:
    """Counts pushes, updates and episodes, and tells of them."""

    def __init__(self, folder: Path, logger: Logger, log_pushes: int) -> None:
        """Make counters at zero.

        Args:
            folder: The run folder.
            logger: Takes each row of `train.csv` as well; its step is the number of pushes.
            log_pushes: Pushes between two rows.
        """
        self.pushes = self.updates = self.episodes = 0
        self.earlier_s = 0.0
        self._began = time.monotonic()
        self._table = TrainTable(folder / "train.csv")
        self._logger = logger
        self._log_pushes = log_pushes
        self._successes: deque[float] = deque(maxlen=WINDOW)
        self._out_of_range: deque[float] = deque(maxlen=WINDOW)
        self._lengths: deque[float] = deque(maxlen=WINDOW)
        self._returns: deque[float] = deque(maxlen=WINDOW)
        self._return: dict[int, float] = {}  # of running episodes, by trajectory
        self._carried = 0.0  # return so far of the episode that goes on from a checkpoint
        self._losses: deque[float] = deque(maxlen=WINDOW)
        self._since = (self._began, 0, 0)

    @property
    def seconds(self) -> float:
        """Wall seconds of training, over every time it was gone on with."""
        return self.earlier_s + time.monotonic() - self._began

    def open(self, total: int, minutes: float | None = None) -> None:
        """Begin to show the live line, and cut what `train.csv` has of the time after now.

        Args:
            total: Pushes after which the training ends; the line shows the time left to them.
            minutes: Of training after which it ends if that is sooner; shown as well.
        """
        self._minutes = minutes
        self._table.cut(self.pushes)
        self._began = time.monotonic()  # without the time that it took to build all parts
        self._since = (time.monotonic(), self.pushes, self.updates)
        self._bar = tqdm(total=total, initial=self.pushes, unit="push", disable=None)

    def close(self) -> None:
        """Leave the live line."""
        self._bar.close()

    def updated(self, figures: dict[str, float]) -> None:
        """Count one update."""
        self.updates += 1
        self._losses.append(figures["loss"])

    def pushed(self, collected: TensorDictBase) -> None:
        """Count [T] pushes as a collector hands them over."""
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
            self._successes.append(float(outcome["success"][i]))
            self._out_of_range.append(float(outcome["out_of_range"][i]))
            self._lengths.append(float(outcome["pushes"][i]))
            self._returns.append(total)
        self.pushes += len(trajectories)

    def tell(self, epsilon: float, n_objects: int) -> None:
        """Show the counters; log a row when it is time."""
        clock, pushes, updates = self._since
        took = max(time.monotonic() - clock, 1e-9)
        figures = {
            "pushes": self.pushes,
            "updates": self.updates,
            "episodes": self.episodes,
            "seconds": round(self.seconds, 1),
            "pushes_per_s": round((self.pushes - pushes) / took, 2),
            "updates_per_s": round((self.updates - updates) / took, 3),
            "success_rate": _mean(self._successes),
            "out_of_range_rate": _mean(self._out_of_range),
            "episode_pushes": _mean(self._lengths),
            "return": _mean(self._returns),
            "loss": _mean(self._losses),
            "epsilon": epsilon,
            "n_objects": n_objects,
        }
        spent = (
            "" if self._minutes is None else f"{self.seconds / 60:.0f} of {self._minutes:g} min, "
        )
        self._bar.set_postfix_str(
            f"{spent}{self.updates} updates, {figures['updates_per_s']:.1f}/s, "
            f"success {figures['success_rate']:.0%}, loss {figures['loss']:.3f}, "
            f"epsilon {epsilon:.2f}, {n_objects} objects",
            refresh=False,
        )
        self._bar.update(self.pushes - self._bar.n)
        if self.pushes // self._log_pushes > pushes // self._log_pushes:
            self._table.append(figures)
            self._logger.log(
                self.pushes, {f"train/{name}": float(value) for name, value in figures.items()}
            )
            self._since = (time.monotonic(), self.pushes, self.updates)

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint keeps."""
        recent = (self._successes, self._out_of_range, self._lengths, self._returns, self._losses)
        return {
            "counters": [self.pushes, self.updates, self.episodes],
            "seconds": self.seconds,
            "recent": [list(values) for values in recent],
            "running": sum(self._return.values(), self._carried),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from what a checkpoint kept."""
        self.pushes, self.updates, self.episodes = (int(count) for count in state["counters"])
        self.earlier_s = float(state["seconds"])
        recent = (self._successes, self._out_of_range, self._lengths, self._returns, self._losses)
        for values, kept in zip(recent, state["recent"], strict=True):
            values.clear()
            values.extend(map(float, kept))
        self._carried = float(state["running"])

    def new_episodes(self) -> None:
        """Take it that no episode goes on: the actors begin new ones."""
        self._carried = 0.0


def _mean(values: deque[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _plain(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.6g}"
