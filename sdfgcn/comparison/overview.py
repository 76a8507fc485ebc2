"""How far a comparison is: jobs done, running and left, and the time that is left."""

from __future__ import annotations

import csv
import json
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sdfgcn.comparison.plan import DONE, Plan, cell_name, cells

_LOOK = 5.0  # seconds between two looks at the files
_REPEAT = 600.0  # seconds after which a log, which is no terminal, gets the line again
_TRAINING = 0.5  # share of a job's progress that its training is


@dataclass(frozen=True)
class Job:
    """A method with one training seed.

    Attributes:
        method: A key of the experiment's methods.
        seed: The training seed.
        folder: The job's folder.
        training: The folder of its training.
    """

    method: str
    seed: int
    folder: Path
    training: Path


def jobs(plan: Plan, folder: Path, methods: Sequence[str], seeds: Sequence[int]) -> list[Job]:
    """The jobs of a sweep that writes to a folder."""
    return [
        Job(
            method,
            seed,
            folder / method / f"seed_{seed}",
            plan.trainings(method) / f"seed_{seed}",
        )
        for method in methods
        for seed in seeds
    ]


def progress(job: Job, plan: Plan) -> float:
    """The share of a job that is done, 0 to 1, from its files."""
    if (job.folder / DONE).exists():
        return 1.0
    shares = [_played(job.folder / cell_name(cell)) for cell in cells(plan.experiment)]
    if any(shares):
        return _TRAINING + (1.0 - _TRAINING) * sum(shares) / len(shares)
    return _TRAINING * min(1.0, _pushes(job.training / "train.csv") / plan.budget.pushes)


def _played(path: Path) -> float:
    """The share of a cell's episodes that have been played; unfinished cells count as half."""
    try:
        status = json.loads((path / "status.json").read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):
        return 0.0
    return 1.0 if status.get("state") == "done" else 0.5


def _pushes(table: Path) -> int:
    """The pushes of a training so far."""
    try:
        with table.open(encoding="utf-8", newline="") as file:
            return max((int(row["pushes"]) for row in csv.DictReader(file)), default=0)
    except (FileNotFoundError, ValueError, TypeError):
        return 0


def line(name: str, shares: dict[Job, float], begun: dict[Job, float], seconds: float) -> str:
    """The overview in one line.

    Args:
        name: The experiment's name.
        shares: The progress of each job now.
        begun: The same when the command started.
        seconds: Since then.
    """
    done = sum(share >= 1.0 for share in shares.values())
    running = [job for job, share in shares.items() if begun[job] < share < 1.0]
    gained = sum(shares[job] - begun[job] for job in shares)
    left = sum(1.0 - share for share in shares.values())
    told = ", ".join(f"{job.method} seed {job.seed} {shares[job]:.0%}" for job in running)
    return (
        f"{name}: {done} of {len(shares)} jobs done, {len(running)} running"
        f"{f' ({told})' if told else ''}, {len(shares) - done - len(running)} left, "
        f"ETA {_duration(seconds * left / gained) if gained > 0.0 else 'unknown'}"
    )


def _duration(seconds: float) -> str:
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60} min" if minutes >= 60 else f"{minutes} min"


class Overview:
    """Shows the line on stderr while the sweep runs."""

    def __init__(self, plan: Plan, every: Sequence[Job]) -> None:
        """Look at the files once; `start` begins to show the line."""
        self._plan = plan
        self._jobs = every
        self._begun = self._look()
        self._clock = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Show the line until `stop`."""
        self._thread.start()

    def stop(self) -> None:
        """Show the line for the last time."""
        self._ended.set()
        self._thread.join()

    def _look(self) -> dict[Job, float]:
        return {job: progress(job, self._plan) for job in self._jobs}

    def _run(self) -> None:
        live = sys.stderr.isatty()
        told, when = "", -_REPEAT
        while True:
            ended = self._ended.wait(_LOOK)
            now = time.monotonic()
            shares = self._look()
            text = line(self._plan.experiment.name, shares, self._begun, now - self._clock)
            if live:
                print(f"\r\x1b[K{text}", end="\n" if ended else "", file=sys.stderr, flush=True)
            elif ended or now - when > _REPEAT or text.partition(",")[0] != told:
                print(text, file=sys.stderr, flush=True)
                told, when = text.partition(",")[0], now
            if ended:
                return
