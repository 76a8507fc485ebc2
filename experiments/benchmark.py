"""Benchmark of the environment: pushes per second and core, and where the time goes.

    python experiments/benchmark.py                       both robots, 3 scanned objects
    python experiments/benchmark.py perception=vision     masks and matches from the picture
    python experiments/benchmark.py pushes=100 objects=household

Makes random legal pushes in this process, on one core, with a reset after each episode and after
at most `episode=15` pushes, the length of a rule-based episode with three objects. Writes
`benchmark.json` (or `benchmark_vision.json` and so on for other options): every repeat, and
the least, median and most pushes per second. Rates are by wall clock, so use a quiet machine;
`pushes_per_cpu_second` counts only this process's CPU time. `ms_per_push` splits the time of a
push, with its share of the resets, into disjoint parts; `python` is the rest.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")  # software OpenGL: render in this thread
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import functools
import platform
import resource
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import torch
from common import file_name, load, parse, run, save
from tqdm import tqdm

import sdfgcn.sim.world as sim_world
from sdfgcn.config import Config
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.perception.matching import Matcher
from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.provenance import provenance
from sdfgcn.registry import ROBOTS, SEGMENTERS
from sdfgcn.sim.renderer import Renderer
from sdfgcn.task.push_space import PushSpace

PARTS = {
    "physics": [
        (mujoco, name)
        for name in (
            "mj_step",
            "mj_resetData",
            "mj_kinematics",
            "mj_collision",
            "mj_comPos",
            "mj_makeM",
            "mj_mulM",
        )
    ],
    "rendering": [(Renderer, "geom_ids"), (Renderer, "pixels")],
    "segmentation": [(segmenter, "__call__") for segmenter in SEGMENTERS.values()],
    "matching": [(Matcher, "features"), (Matcher, "match")],
    "sdf": [(SdfTransform, "fields")],
    "push_start": [(PushSpace, "plan"), (PushSpace, "centers")],
    "inverse_kinematics": [(robot, "solve") for robot in ROBOTS.values()],
    "reset_draw": [(sim_world, "draw_episode")],
}


class Stopwatch:
    """Adds up the wall-clock time spent in functions, by part.

    Nested calls of timed functions count towards the outer one, so no time counts twice.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._running = False
        for part, functions in PARTS.items():
            for owner, name in functions:
                setattr(owner, name, self._timed(part, getattr(owner, name)))

    def _timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(function)
        def timed(*args: Any, **kwargs: Any) -> Any:
            if self._running:
                return function(*args, **kwargs)
            self._running, began = True, time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self._running = False
                self.seconds[part] += time.perf_counter() - began
                self.calls[part] += 1

        return timed

    def clear(self) -> None:
        self.seconds.clear()
        self.calls.clear()


def measure(
    overrides: list[str], pushes: int, episode: int, stopwatch: Stopwatch
) -> dict[str, Any]:
    """Make `pushes` random legal pushes, at most `episode` of them before a reset."""
    config = load(overrides)
    env = RearrangementEnv(config.env)
    env.reset_episode(0)
    stopwatch.clear()
    made = episodes = 0
    reset_seconds = 0.0
    rng = np.random.default_rng(0)
    statuses: Counter[str] = Counter()
    began, cpu_began = time.perf_counter(), time.process_time()
    with tqdm(total=pushes, unit="push", desc=" ".join(overrides)) as bar:
        while made < pushes:
            episodes += 1
            reset_began = time.perf_counter()
            td = env.reset_episode(episodes)
            reset_seconds += time.perf_counter() - reset_began
            for _ in range(min(episode, pushes - made)):
                action = rng.choice(np.flatnonzero(td["action_mask"].numpy()))
                td = env.step(td.set("action", torch.tensor(action)))["next"]
                assert env.last_step is not None
                statuses[env.last_step.push.result.status] += 1
                made += 1
                bar.update()
                if td["done"]:
                    break
    seconds, cpu = time.perf_counter() - began, time.process_time() - cpu_began
    env.close()
    parts = {part: stopwatch.seconds[part] for part in PARTS}
    parts["python"] = seconds - sum(parts.values())
    return {
        "perception": config.env.perception.name,
        "objects": config.env.objects.name,
        "robot": config.env.robot.name,
        "n_objects": config.n_objects,
        "split": config.env.split,
        "pushes": made,
        "episodes": episodes,
        "statuses": dict(statuses),
        "pushes_per_second": made / seconds,
        "pushes_per_cpu_second": made / cpu,
        "ms_per_push": {part: 1e3 * value / made for part, value in parts.items()},
        "ms_per_reset": 1e3 * reset_seconds / episodes,
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def result_name(config: Config) -> str:
    """The result's file name, distinct for every perception and object source."""
    return file_name(
        "benchmark", (config.env.perception.name, config.env.objects.name), {"oracle", "scanned"}
    )


def main() -> None:
    given = parse(sys.argv[1:], {"pushes": 400, "repeats": 3, "episode": 15}, __doc__ or "")
    own, overrides = given.own, given.overrides
    torch.set_num_threads(1)
    stopwatch = Stopwatch()
    load(overrides)  # mistakes are told before anything is measured
    runs = [
        measure([*overrides, f"robot={robot}"], own["pushes"], own["episode"], stopwatch)
        for _ in range(own["repeats"])
        for robot in ROBOTS
    ]
    rates = {
        robot: sorted(run["pushes_per_second"] for run in runs if run["robot"] == robot)
        for robot in ROBOTS
    }
    save(
        given.folder,
        result_name(load(overrides)),
        {
            "machine": {
                "processor": platform.processor() or platform.machine(),
                "cores": os.cpu_count(),
                "load_average": os.getloadavg()[0],
            },
            **provenance(),
            "pushes_per_second": {
                robot: {"median": float(np.median(rate)), "least": rate[0], "most": rate[-1]}
                for robot, rate in rates.items()
            },
            "runs": runs,
        },
    )


if __name__ == "__main__":
    sys.exit(run(main))
