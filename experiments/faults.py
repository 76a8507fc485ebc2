"""Kills runs at random moments, resumes them, and compares them with runs that nobody disturbed.

    python experiments/faults.py                 25 minutes, into outputs/faults/DATE_TIME/
    python experiments/faults.py minutes=5 seed=1
    python experiments/faults.py outputs/faults/A outputs/faults/B      several of these in one
    python experiments/faults.py --publish       also into experiments/results/faults.{json,md}

Evaluations, trainings and sweeps are struck up to three times by SIGKILL, SIGTERM or SIGINT, each
time resumed by the same command, and then left to end. Rows and weights must be those of an
undisturbed run, bit for bit; a training with `collector=async` must end with all its pushes, all of
them in its replay buffer. Other runs are given a disk that is too small, or lose their folder. None
may leave a process behind, a traceback, or a `status.json` that says `running` unless it was killed
by SIGKILL. Disks that are too small need `unshare` and user namespaces.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("LP_NUM_THREADS", "0")  # software OpenGL: render in this thread
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import csv
import hashlib
import importlib
import json
import multiprocessing
import shutil
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import common
import numpy as np
from common import PUBLISH, RESULTS, ROOT, load, parse
from faults_process import Ended, run, run_on_small_disk
from faults_table import STRIKES, Strike, Trial, markdown, outcome, united, write
from tqdm import tqdm

from sdfgcn.errors import SdfgcnError

PRELOADED = ("sdfgcn.cli", "sdfgcn.train.training", "sdfgcn.envs.rearrangement", "scipy.stats")
TIMES = {"wall_s", "seconds", "pushes_per_s", "updates_per_s"}

SMALL = ("objects=household", "robot=gripper", "n_objects=2", "env.pushes_per_object=3", "viz=none")
EVALUATION = (*SMALL, "model=rule_based", "eval.episodes=6")
TRAINING = (
    *(*SMALL, "eval.episodes=1", "budget=smoke", "budget.minutes=null", "budget.pushes=60"),
    *("budget.epsilon_pushes=60", "train.learning_starts=10", "train.batch_size=8"),
    *("train.env.pushes_per_object=6", "collector.pushes_per_batch=10", "train.log_pushes=10"),
    *("train.checkpoint_minutes=0.0001", "runtime.workers=0", "runtime.precision=float32"),
)
SYNC = (*TRAINING, "collector=sync", "model=gt_pose_gcn")
GROWING = (
    *("curriculum=on", "curriculum.window=2", "curriculum.success_threshold=0.05"),
    *("curriculum.confidence=0.5", "+train.env.success_threshold=0.2"),
)


@dataclass(frozen=True)
class Case:
    """A command to disturb.

    Attributes:
        name: What it does.
        arguments: Without its folder.
        share: How often it is tried, relative to the others.
        exact: Whether a resumed run equals an undisturbed one bit for bit.
    """

    name: str
    arguments: tuple[str, ...]
    share: int = 1
    exact: bool = True

    def command(self, folder: Path) -> list[str]:
        key = "hydra.sweep.dir" if "-m" in self.arguments else "hydra.run.dir"
        return [*self.arguments, f"{key}={folder}"]


CASES = (
    Case("evaluation", (*EVALUATION, "runtime.workers=0"), 2),
    Case("evaluation, 2 workers", (*EVALUATION, "runtime.workers=2")),
    Case("training, sync, her=next", (*SYNC, "her=next"), 2),
    Case("training, sync, her=future", (*SYNC, "her=future"), 2),
    Case("training, sync, her=future, curriculum=on", (*SYNC, "her=future", *GROWING), 2),
    Case("training, sync, push_model", (*TRAINING, "collector=sync", "model=push_model"), 2),
    Case(
        "training, async",
        (*TRAINING, "collector=async", "model=gt_pose_gcn", "her=off"),
        exact=False,
    ),
    Case("sweep", ("-m", *EVALUATION, "runtime.workers=0", "eval.seed=1,2"), 2),
    Case(
        "sweep, joblib",
        ("-m", *EVALUATION, "runtime.workers=0", "eval.seed=1,2", "hydra/launcher=joblib"),
    ),
)


# ---------------------------------------------------------------------- strikes


def struck_by(number: int, whole_group: bool, pid: int) -> None:
    """Send a signal to a process, or to its group, as terminals and schedulers do."""
    with suppress(ProcessLookupError):
        (os.killpg if whole_group else os.kill)(pid, number)


STRIKE = {
    "SIGKILL": partial(struck_by, signal.SIGKILL, False),
    "SIGTERM": partial(struck_by, signal.SIGTERM, False),
    "SIGTERM to all": partial(struck_by, signal.SIGTERM, True),
    "SIGINT to all": partial(struck_by, signal.SIGINT, True),
}
ODDS = (0.55, 0.2, 0.1, 0.15)
CODES = {"SIGKILL": -9, "SIGTERM": 143, "SIGTERM to all": 143, "SIGINT to all": 130}


def complaints(fault: str, ended: Ended, told: Sequence[str]) -> list[str]:
    """What is wrong with how a run ended after a strike; `told` are the states that it wrote."""
    found = []
    if ended.code is None:
        found.append("hung")
    if ended.orphans:
        found.append(f"{ended.orphans} processes left")
    if "Traceback" in ended.log:
        found.append(f"traceback: {ended.log.strip().splitlines()[-1][:200]}")
    if fault != "SIGKILL" and "running" in told:
        found.append("status.json says running")
    # A signal may come before the run has begun, or at its end.
    expected = {CODES.get(fault, 1), 0}
    if ended.code is not None and ended.code not in expected and told:
        found.append(f"exit code {ended.code}, not {CODES.get(fault, 1)}")
    return found


# ---------------------------------------------------------------------- what a run left


def statuses(folder: Path) -> dict[Path, str]:
    """Every `status.json` below a folder."""
    return {path: path.read_text() for path in sorted(folder.rglob("status.json"))}


def states(now: dict[Path, str], before: dict[Path, str]) -> list[str]:
    """The states in the files that have changed."""
    changed = [text for path, text in now.items() if text != before.get(path)]
    return [json.loads(text)["state"] for text in changed]


def left_in(folder: Path) -> dict[str, Any]:
    """Rows and weights below a folder, by file, without what depends on time."""
    found: dict[str, Any] = {}
    for name in ("episodes.csv", "train.csv"):
        for path in sorted(folder.rglob(name)):
            with path.open(newline="") as file:
                rows = [
                    {key: value for key, value in row.items() if key not in TIMES}
                    for row in csv.DictReader(file)
                ]
            found[str(path.relative_to(folder))] = rows
    for path in sorted(folder.rglob("weights.safetensors")):
        found[str(path.relative_to(folder))] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def kept(folder: Path, arguments: Sequence[str]) -> tuple[int, int]:
    """Pushes of a training, and transitions in its last checkpoint's replay buffer."""
    fork = multiprocessing.get_context("fork")  # the runs to come are forked from this process
    with ProcessPoolExecutor(1, fork) as pool:
        transitions = pool.submit(_transitions, folder, tuple(arguments)).result()
    about = json.loads((folder / "policy" / "policy.json").read_text())
    return int(about["spent"]["pushes"]), transitions


def _transitions(folder: Path, arguments: tuple[str, ...]) -> int:
    """Load a checkpoint as a resumed training would, and count."""
    from sdfgcn.loggers.files import NoLogger
    from sdfgcn.train.training import build_trainer, q_network

    config = load([each.replace("collector=async", "collector=sync") for each in arguments])
    logger = NoLogger(config.logger, folder)
    trainer = build_trainer(config, folder, logger, q_network, lambda network, spent: None, None)
    return len(trainer._replay)


def differences(case: Case, folder: Path, whole: dict[str, Any]) -> list[str]:
    """How a resumed run differs from an undisturbed one."""
    here = left_in(folder)
    if case.exact:
        return [
            f"other {file}" for file in sorted({*whole, *here}) if whole.get(file) != here.get(file)
        ]
    found = []
    if [row["seed"] for row in here["episodes.csv"]] != [
        row["seed"] for row in whole["episodes.csv"]
    ]:
        found.append("other episodes")
    pushes, transitions = kept(folder, case.arguments)
    if pushes < 60 or transitions != pushes:
        found.append(f"{pushes} pushes, {transitions} of them in the replay buffer")
    return found


# ---------------------------------------------------------------------- trials


class Faults:
    """Disturbs runs; all folders are below one."""

    def __init__(self, folder: Path, seed: int) -> None:
        self._folder = folder
        self._rng = np.random.default_rng(seed)
        self._whole: dict[str, tuple[dict[str, Any], float]] = {}
        self._count = 0

    def mixed(self, cases: Sequence[Case]) -> list[Case]:
        """The cases in random order."""
        return [cases[k] for k in self._rng.permutation(len(cases))]

    def undisturbed(self, case: Case) -> tuple[dict[str, Any], float]:
        """What a run leaves that nobody disturbs, and its seconds."""
        if case.name not in self._whole:
            path = self._new()
            ended = run(case.command(path), self._log(path))
            if ended.code != 0:
                raise SystemExit(f"{case.name} does not run undisturbed:\n{ended.log}")
            self._whole[case.name] = left_in(path), ended.seconds
        return self._whole[case.name]

    def resumed(self, case: Case) -> Trial:
        """Strike a run a few times, resuming it each time."""
        whole, seconds = self.undisturbed(case)
        path = self._new()
        strikes: list[Strike] = []
        for _ in range(STRIKES):
            fault = str(self._rng.choice(list(STRIKE), p=ODDS))
            after = float(self._rng.uniform(0.0, seconds))
            before = statuses(path)
            ended = run(case.command(path), self._log(path), STRIKE[fault], after)
            if not ended.struck:
                break
            wrong = complaints(fault, ended, states(statuses(path), before))
            strikes.append(Strike(case.name, fault, round(after, 2), wrong))
        ended = run(case.command(path), self._log(path))
        wrong = complaints("none", ended, [])
        end = set(states(statuses(path), {}))
        if ended.code != 0:
            wrong.append(f"does not resume: {ended.log.strip()[-300:]}")
        elif end != {"done"}:
            wrong.append(f"ends as {sorted(end)}")
        else:
            wrong += differences(case, path, whole)
        if not wrong:
            shutil.rmtree(path)
        return Trial(case.name, strikes, wrong)

    def deleted(self, case: Case) -> Strike | None:
        """Delete a run's folder under it; None if it ended before."""
        _, seconds = self.undisturbed(case)
        path, after = self._new(), float(self._rng.uniform(0.0, seconds))

        def delete(pid: int) -> None:
            shutil.rmtree(path, ignore_errors=True)

        ended = run(case.command(path), self._log(path), delete, after)
        if not ended.struck:
            return None
        return Strike(
            case.name, "folder deleted", round(after, 2), complaints("deleted", ended, [])
        )

    def full(self, case: Case) -> Strike | None:
        """Give a run too small a disk; None if it was large enough, or cannot be made."""
        kilobytes = int(np.exp(self._rng.uniform(np.log(8.0), np.log(2000.0))))
        path = self._new()
        ended = run_on_small_disk(case.arguments, path, kilobytes)
        if ended is None or not ended.struck:
            return None
        wrong = complaints("disk full", ended, states(statuses(path / "run"), {}))
        if "No space left" not in ended.log:
            wrong.append(f"says {ended.log.strip().splitlines()[-1:]}")
        return Strike(case.name, "disk full", round(ended.seconds, 2), wrong)

    def _new(self) -> Path:
        self._count += 1
        return self._folder / "runs" / f"{self._count:04d}"

    def _log(self, path: Path) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.with_suffix(f".{time.monotonic_ns()}.log")


# ---------------------------------------------------------------------- the whole


def disturbed(faults: Faults, minutes: int) -> Iterator[Trial | Strike | None]:
    """Disturb runs until the time is up; every fifth gets a full disk or loses its folder."""
    turn = faults.mixed([case for case in CASES for _ in range(case.share)])
    until, k, others = time.monotonic() + 60.0 * minutes, 0, 0
    while time.monotonic() < until:
        if k % 5 == 4:
            case = CASES[(0, 2)[others // 2 % 2]]
            yield (faults.full, faults.deleted)[others % 2](case)
            others += 1
        else:
            yield faults.resumed(turn[(k - others) % len(turn)])
        k += 1


def main(arguments: Sequence[str]) -> None:
    own, folders, _ = parse(arguments, {"minutes": 25, "seed": 0}, __doc__ or "")
    if lost := [name for name in folders if not (Path(name) / "faults.json").exists()]:
        raise SdfgcnError(
            f"There is no {lost[0]}/faults.json; see python experiments/faults.py --help."
        )
    folder = ROOT / "outputs" / "faults" / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    if folders:
        result = united([json.loads((Path(name) / "faults.json").read_text()) for name in folders])
        write(folder, result)
    else:
        result = tried(folder, own)
    if PUBLISH in arguments:
        write(RESULTS, result)
    print(markdown(result), f"Written to {folder}", sep="\n")


def tried(folder: Path, own: dict[str, int]) -> dict[str, Any]:
    """Disturb runs for so many minutes; what is known so far is always in the folder."""
    for module in PRELOADED:
        importlib.import_module(module)
    exact = {case.name: case.exact for case in CASES}
    trials: list[Trial] = []
    others: list[Strike] = []
    result = outcome(trials, others, exact, own)
    began = time.monotonic()
    with tqdm(total=60 * own["minutes"], unit="s") as bar:
        for each in disturbed(Faults(folder, own["seed"]), own["minutes"]):
            trials += [each] if isinstance(each, Trial) else []
            others += [each] if isinstance(each, Strike) else []
            result = outcome(trials, others, exact, own)
            write(folder, result)
            bar.set_postfix_str(f"{result['strikes']} strikes, {len(result['wrong'])} wrong")
            bar.update(min(bar.total, round(time.monotonic() - began)) - bar.n)
    return result


if __name__ == "__main__":
    sys.exit(common.run(lambda: main(sys.argv[1:])))
