"""A soak: hours of pushing, in which nothing may leak, break or become slow.

    python experiments/soak.py                                  an hour
    python experiments/soak.py hours=8 --publish
    python experiments/soak.py hours=0.1 objects=household robot=gripper
    python experiments/soak.py hours=2 --resume                 one more process, with other scenes

Pushes with both robots and both perceptions, with 2 to 12 objects in turn; every other episode is
pushed at random, the others by the rule-based agent with one push in ten at random. Looks for NaN
in poses, SDFs and rewards, for MuJoCo's warnings, for memory and file descriptors that grow, and
for the slowest push. The result is written every minute, to `outputs/soak.json` or, with
`--publish`, to `experiments/results/soak.json`; `runs` holds a row for each process. Times are by
wall clock unless they say CPU.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import monotonic, process_time
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.setdefault("LP_NUM_THREADS", "0")  # software OpenGL: render in this thread
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import mujoco
import numpy as np
import torch
from common import RESULTS, ROOT, load
from tensordict import TensorDictBase

from sdfgcn.agents import EpsilonGreedy, build_agent
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import write_json
from sdfgcn.progress_bar import progress_bar
from sdfgcn.provenance import provenance

ROBOTS = ("gripper", "ur5e")
PERCEPTIONS = {"oracle": 3.0, "vision": 1.0}  # and their shares of the time: vision steps less
N_OBJECTS = range(2, 13)
EPSILONS = {"random": 1.0, "rule_based": 0.1}  # agent -> share of random pushes
SAMPLE_SECONDS = 60.0  # between two looks at memory and descriptors, and two files
WARM = 0.5  # memory may grow at first, while caches fill: the trend is that of the later half


@dataclass
class Case:
    """One env, and what was done in it.

    Attributes:
        name: Its robot and perception.
        share: Of the time, against the other cases.
        env: The env.
        agents: By name.
        episodes: Episodes so far, also of earlier processes; the next one's seed.
        begun: Episodes of earlier processes.
        seconds: Wall time spent in it.
        pushes: Pushes made.
        simulated: Seconds of simulated time.
        resets: Episodes, by number of objects.
        statuses: What became of the pushes.
    """

    name: str
    share: float
    env: RearrangementEnv
    agents: dict[str, EpsilonGreedy]
    episodes: int = 0
    begun: int = 0
    seconds: float = 0.0
    pushes: int = 0
    simulated: float = 0.0
    resets: Counter = field(default_factory=Counter)
    statuses: Counter = field(default_factory=Counter)

    def about(self) -> dict[str, Any]:
        """The counts, in JSON types."""
        return {
            "case": self.name,
            "hours": self.seconds / 3600,
            "simulated_seconds": self.simulated,
            "pushes": self.pushes,
            "first_seed": self.begun,
            "episodes": self.episodes - self.begun,
            "episodes_by_n_objects": {str(n): count for n, count in sorted(self.resets.items())},
            "statuses": dict(self.statuses),
        }


class Meter:
    """Counts simulated time and MuJoCo's warnings; a reset of MuJoCo's data would clear both."""

    def __init__(self) -> None:
        self.simulated = 0.0
        self.warnings: Counter[str] = Counter()
        step = mujoco.mj_step

        def counted(model: mujoco.MjModel, data: mujoco.MjData, nstep: int = 1) -> None:
            step(model, data, nstep)
            self.simulated += nstep * model.opt.timestep

        mujoco.mj_step = counted
        mujoco.set_mju_user_warning(self._warned)

    def _warned(self, message: str) -> None:
        self.warnings[str(message).partition(" Time =")[0]] += 1


class Soak:
    """Pushes, and keeps what was seen on the way."""

    def __init__(self, cases: Sequence[Case], about: dict[str, Any]) -> None:
        self.cases = cases
        self._about = about
        self._meter = Meter()
        self._began, self._cpu = monotonic(), process_time()
        self._slowest: dict[str, dict[str, Any]] = {}
        self._nan: list[dict[str, Any]] = []
        self.samples: list[dict[str, float]] = []

    @property
    def seconds(self) -> float:
        """Wall time so far."""
        return monotonic() - self._began

    @property
    def simulated(self) -> float:
        """Simulated time so far, seconds."""
        return self._meter.simulated

    @property
    def pushes(self) -> int:
        """Pushes so far."""
        return sum(case.pushes for case in self.cases)

    def play(self, case: Case) -> None:
        """Play one episode; the number of objects and the agent follow from how many there were."""
        began = monotonic()
        agent = list(case.agents)[case.episodes % len(case.agents)]
        turn = case.episodes // len(case.agents)
        case.env.n_objects = N_OBJECTS[turn % len(N_OBJECTS)]
        seed, simulated, cpu = case.episodes, self._meter.simulated, process_time()
        where = {"case": case.name, "n_objects": case.env.n_objects, "agent": agent, "seed": seed}
        td = case.env.reset_episode(seed)
        self._timed("reset", process_time() - cpu, where)
        self._look(case, td, {**where, "push": 0})
        while not td["done"]:
            cpu = process_time()
            td = case.env.step(case.agents[agent](td))["next"]
            case.pushes += 1
            case.statuses[case.env.last_step.push.result.status] += 1
            here = {**where, "push": case.env.last_step.index}
            self._timed("push", process_time() - cpu, here)
            self._look(case, td, here)
        case.episodes += 1
        case.resets[case.env.n_objects] += 1
        case.seconds += monotonic() - began
        case.simulated += self._meter.simulated - simulated

    def _timed(self, kind: str, seconds: float, where: dict[str, Any]) -> None:
        """Remember the slowest push and reset."""
        if seconds > self._slowest.get(kind, {"cpu_seconds": 0.0})["cpu_seconds"]:
            self._slowest[kind] = {"cpu_seconds": seconds, **where}

    def _look(self, case: Case, td: TensorDictBase, where: dict[str, Any]) -> None:
        """Look for numbers that are none."""
        values = [td["scene", key] for key in ("sdf", "center", "position")]
        values.append(torch.as_tensor(case.env.world.poses()))
        if case.env.last_step is not None:
            values.append(torch.tensor(case.env.last_step.reward))
        if not all(bool(torch.isfinite(value).all()) for value in values):
            self._nan.append(where)

    def sample(self) -> None:
        """Look at this process's memory and file descriptors."""
        status = Path("/proc/self/status").read_text()
        resident = next(line for line in status.splitlines() if line.startswith("VmRSS"))
        self.samples.append(
            {
                "minutes": round(self.seconds / 60, 2),
                "rss_mib": round(int(resident.split()[1]) / 1024, 1),
                "descriptors": len(os.listdir("/proc/self/fd")),  # noqa: PTH208 - counts no Paths
                "pushes": self.pushes,
                "simulated_seconds": round(self._meter.simulated, 1),
            }
        )

    def result(self) -> dict[str, Any]:
        """Everything so far, in JSON types."""
        return {
            **self._about,
            "hours": self.seconds / 3600,
            "cpu_hours": (process_time() - self._cpu) / 3600,
            "pushes": self.pushes,
            "episodes": sum(case.episodes - case.begun for case in self.cases),
            "simulated_seconds": self._meter.simulated,
            "simulated_seconds_per_push": self._meter.simulated / max(self.pushes, 1),
            "nan": self._nan,
            "mujoco_warnings": dict(self._meter.warnings),
            "slowest": self._slowest,
            "memory": trend(self.samples, "rss_mib"),
            "descriptors": trend(self.samples, "descriptors"),
            "cases": [case.about() for case in self.cases],
            "samples": self.samples,
        }


def trend(samples: Sequence[dict[str, float]], key: str) -> dict[str, float | None]:
    """First, last and largest value, and the slope over the later part of the samples.

    Returns:
        `first`, `last`, `most` and `per_hour`; the last is None with fewer than three samples in
        the later part.
    """
    values = [sample[key] for sample in samples]
    later = samples[int(WARM * len(samples)) :]
    slope = None
    if len(later) >= 3:
        hours = [sample["minutes"] / 60 for sample in later]
        slope = float(np.polyfit(hours, [sample[key] for sample in later], 1)[0])
    return {"first": values[0], "last": values[-1], "most": max(values), "per_hour": slope}


def cases(overrides: Sequence[str], earlier: Sequence[dict], stack: ExitStack) -> list[Case]:
    """Build an env for each robot and perception, or for those that the overrides name."""
    begun: Counter[str] = Counter()
    for run in earlier:
        begun.update({each["case"]: each["episodes"] for each in run["cases"]})
    made = []
    for robot in asked(overrides, "robot", ROBOTS):
        for perception in asked(overrides, "perception", PERCEPTIONS):
            config = load(
                [
                    "model=rule_based",
                    f"env.max_objects={max(N_OBJECTS)}",
                    *overrides,
                    f"robot={robot}",
                    f"perception={perception}",
                ]
            )
            env = stack.enter_context(closing(RearrangementEnv(config.env, seed=0)))
            agents = {
                name: build_agent(
                    replace(config, eval=replace(config.eval, epsilon=epsilon)),
                    np.random.default_rng(0),
                )
                for name, epsilon in EPSILONS.items()
            }
            name = f"{robot} {perception}"
            share = PERCEPTIONS.get(perception, 1.0)
            made.append(Case(name, share, env, agents, begun[name], begun[name]))
    return made


def asked(overrides: Sequence[str], group: str, options: Iterable[str]) -> list[str]:
    """The option of a group that the overrides name, or else all options."""
    named = [each.partition("=")[2] for each in overrides if each.startswith(f"{group}=")]
    return named[-1:] or list(options)


def soak(
    hours: float, overrides: Sequence[str], path: Path, earlier: Sequence[dict]
) -> dict[str, Any]:
    """Push for so many hours; write the result as it goes.

    Args:
        hours: Wall time.
        overrides: Of the config.
        path: The file to write.
        earlier: The runs of earlier processes, which the result begins with.

    Returns:
        The result.
    """
    torch.set_num_threads(1)
    limit = 3600 * hours
    path.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        made = cases(overrides, earlier, stack)
        config = made[0].env.config
        about = {"env": config.name, "objects": config.objects.name, "split": config.split}
        run = Soak(made, {**about, "overrides": list(overrides), **provenance()})
        run.sample()
        bar = stack.enter_context(progress_bar(total=round(limit), unit="s", desc="Soak"))
        while run.seconds < limit or not run.pushes:
            run.play(min(made, key=lambda case: case.seconds / case.share))
            if run.seconds - 60 * run.samples[-1]["minutes"] >= SAMPLE_SECONDS:
                run.sample()
                write_json(path, together([*earlier, run.result()]))
            bar.set_postfix_str(f"{run.pushes} pushes, {run.simulated:.0f} s", refresh=False)
            bar.update(min(round(run.seconds), bar.total) - bar.n)
        run.sample()
        result = together([*earlier, run.result()])
    write_json(path, result)
    return result


def together(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The runs of several processes, and their sums."""
    sums = ("simulated_seconds", "pushes", "episodes", "hours", "cpu_hours")
    warnings: Counter[str] = Counter()
    for run in runs:
        warnings.update(run["mujoco_warnings"])
    return {
        **{key: sum(run[key] for run in runs) for key in sums},
        "nan": sum(len(run["nan"]) for run in runs),
        "mujoco_warnings": dict(warnings),
        "slowest": {
            kind: max(
                (run["slowest"][kind] for run in runs if kind in run["slowest"]),
                key=lambda one: one["cpu_seconds"],
                default=None,
            )
            for kind in ("push", "reset")
        },
        "runs": list(runs),
    }


def summary(result: dict[str, Any]) -> str:
    """The result in a few lines; memory and descriptors are those of the last process."""
    memory, descriptors = (result["runs"][-1][key] for key in ("memory", "descriptors"))
    slope = memory["per_hour"]
    return "\n".join(
        [
            f"{result['pushes']} pushes, {result['episodes']} episodes, "
            f"{result['simulated_seconds']:.0f} s simulated in {result['hours']:.2f} hours",
            f"memory {memory['first']:.0f} to {memory['last']:.0f} MiB"
            + ("" if slope is None else f", {slope:+.1f} MiB an hour in the later half"),
            f"file descriptors {descriptors['first']:.0f} to {descriptors['last']:.0f}",
            f"NaN: {result['nan']}; MuJoCo's warnings: {result['mujoco_warnings'] or 'none'}",
            *(
                f"slowest {kind}: {one['cpu_seconds']:.2f} s of CPU ({one['case']}, "
                f"{one['n_objects']} objects)"
                for kind, one in result["slowest"].items()
            ),
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "overrides", nargs="*", metavar="key=value", help="hours=1, or overrides as of run.py"
    )
    parser.add_argument("--publish", action="store_true", help="write to experiments/results/")
    parser.add_argument("--resume", action="store_true", help="add to the runs in that file")
    given = parser.parse_args(arguments)
    hours, overrides = 1.0, []
    for each in given.overrides:
        key, _, value = each.partition("=")
        if key == "hours":
            try:
                hours = float(value)
            except ValueError:
                hours = -1.0
        else:
            overrides.append(each)
    if not 0 < hours < 1e4:
        parser.error("hours must be a number of hours above 0, such as hours=0.5")
    path = (RESULTS if given.publish else ROOT / "outputs") / "soak.json"
    earlier = json.loads(path.read_text())["runs"] if given.resume and path.exists() else []
    try:
        result = soak(hours, overrides, path, earlier)
    except SdfgcnError as error:
        print(error, file=sys.stderr)
        return 1
    print(summary(result))
    print(f"Written to {path}.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
