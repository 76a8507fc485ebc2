"""Benchmark of training: pushes and updates per second, by collector and number of workers.

    python experiments/benchmark_training.py              sync; async with 1, 2 and 3 workers
    python experiments/benchmark_training.py seconds=120 model=sdf_cnn

Trains from scratch in each case and writes `benchmark_training.json`. Rates are by wall
clock from the first update on, so use a quiet machine. Each row has the updates per push, since
collector and learner wait for each other when one is far ahead (`train.utd_ratio`,
`train.max_utd_ratio`).
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("LP_NUM_THREADS", "0")  # software OpenGL: render in this thread
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import tempfile
from pathlib import Path
from typing import Any

from common import load, parse, run, save
from learning_curve import read

from sdfgcn.errors import SdfgcnError
from sdfgcn.loggers.files import NoLogger
from sdfgcn.provenance import provenance
from sdfgcn.train.training import q_network, train

CASES: tuple[tuple[str, int], ...] = (("sync", 0), ("async", 1), ("async", 2), ("async", 3))
LOG_PUSHES = 100  # pushes between two readings of the clock


def measure(overrides: list[str], collector: str, workers: int, seconds: int) -> dict[str, Any]:
    """Train for `seconds`; the rates are from the first logged update on."""
    config = load(
        [
            *("model=sdfgcn", f"collector={collector}"),
            *([f"collector.workers={workers}"] if workers else []),
            *(f"budget.minutes={seconds / 60}", f"train.log_pushes={LOG_PUSHES}", *overrides),
        ]
    )
    with tempfile.TemporaryDirectory() as folder:
        train(config, Path(folder), NoLogger(config.logger, Path(folder)), q_network)
        rows = [row for row in read(Path(folder)) if row["updates"] > 0]
    if len(rows) < 2:
        raise SdfgcnError(
            f"seconds={seconds} is too short: {len(rows)} looks at the clock after the first "
            "update; twice the time would do."
        )
    first, last = rows[0], rows[-1]
    took = last["seconds"] - first["seconds"]
    pushes, updates = (last[key] - first[key] for key in ("pushes", "updates"))
    return {
        "model": config.model.name,
        "collector": collector,
        "workers": workers,
        "seconds": took,
        "pushes_per_s": pushes / took,
        "updates_per_s": updates / took,
        "updates_per_push": updates / pushes,
    }


def main() -> None:
    own, overrides, folder = parse(sys.argv[1:], {"seconds": 90}, __doc__ or "")
    load(["model=sdfgcn", *overrides])  # mistakes are told before anything is measured
    rows = [measure(overrides, *case, own["seconds"]) for case in CASES]
    machine = {"cores": os.cpu_count(), "load_average": os.getloadavg()[0]}
    save(folder, "benchmark_training", {"machine": machine, **provenance(), "rows": rows})


if __name__ == "__main__":
    sys.exit(run(main))
