"""`python run.py` with a Q-network: pushes in a process of their own, then an evaluation."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from configs import compose_config, real_config
from recordings import Recording

from sdfgcn import load_policy
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError
from sdfgcn.experiment import run_experiment
from sdfgcn.loggers.services import TensorboardLogger, WandbLogger
from sdfgcn.run_folder import RunFolder

ROOT = Path(__file__).parents[1]
# Every episode succeeds, and each success brings in the next count.
GROWING = (
    *("env.success_threshold=1.0", "curriculum=on", "curriculum.counts=[1,2,3]"),
    *("curriculum.window=1", "curriculum.success_threshold=0.0", "curriculum.newest_share=1.0"),
)
SMALL = (
    *("objects=household", "robot=gripper", "n_objects=2", "env.pushes_per_object=1"),
    *("budget=smoke", "budget.pushes=50", "collector.pushes_per_batch=5", "logger=none"),
    *("train.learning_starts=5", "train.batch_size=4", "train.log_pushes=10"),
    *("eval.episodes=1", "runtime.workers=0", "viz.episodes=1"),
)


def run(*arguments: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, str(ROOT / "run.py"), *arguments],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=240,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run folder of a training that pushes in another process, and of its evaluation."""
    folder = tmp_path_factory.mktemp("run")
    done = run(*SMALL, *GROWING, "model=gt_pose_gcn", "collector=async", f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    assert done.stderr == f"Run folder: {folder}\n"
    assert "gt_pose_gcn (this run)" in done.stdout
    return folder


def test_trains_then_evaluates(folder: Path) -> None:
    with (folder / "train.csv").open() as file:
        last = list(csv.DictReader(file))[-1]
    assert int(last["pushes"]) >= 50
    assert json.loads((folder / "status.json").read_text())["state"] == "done"
    about = json.loads((folder / "policy" / "policy.json").read_text())
    assert about["model"]["name"] == "gt_pose_gcn"
    assert about["budget"]["pushes"] == 50
    assert json.loads((folder / "results.json").read_text())["model"] == "gt_pose_gcn"


def test_other_processes_hear_of_a_new_count(folder: Path) -> None:
    """The third count comes in only when the other process has played episodes of the second."""
    with (folder / "train.csv").open() as file:
        counts = [int(row["n_objects"]) for row in csv.DictReader(file)]
    assert counts[-1] == 3


def test_q_values_are_in_the_recording(folder: Path) -> None:
    """Of every object and direction, as the policy gives them at the start of the episode."""
    recording = Recording(folder / "recordings" / "episode_000.rrd")
    kept = recording["/q_values", "Tensor:data"][1][0]
    with (folder / "episodes.csv").open() as file:
        seed = int(next(csv.DictReader(file))["seed"])
    with closing(RearrangementEnv(real_config(*SMALL).env)) as env:
        given = load_policy(folder)(env.reset_episode(seed))["action_value"]
        values = env.push_space.by_direction(given)[:2].numpy()
    assert kept["shape"] == list(values.shape) == [2, 8]
    np.testing.assert_allclose(kept["buffer"], values.ravel(), atol=1e-5)
    assert "| #1 " in recording["/q_values/table", "TextDocument:text"][1][0]


def test_evaluates_a_checkpoint_without_training(folder: Path, tmp_path: Path) -> None:
    overrides = (*SMALL, "model=gt_pose_gcn", f"checkpoint={folder}", "eval=greedy", "viz=none")
    overrides = (*overrides, "eval.episodes=1")
    with RunFolder(tmp_path, compose_config(*overrides)) as held:
        results = run_experiment(real_config(*overrides), held)
    assert results["episodes"] == 1
    assert not (tmp_path / "train.csv").exists()


# ------------------------------------------------------------------ loggers


@pytest.mark.parametrize("logger", [TensorboardLogger, WandbLogger])
def test_a_missing_logger_is_one_sentence(
    logger: type, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SdfgcnError, match=r"pip install 'sdfgcn\[(tensorboard|wandb)\]'"):
        logger(real_config().logger, tmp_path)


def test_tensorboard_gets_the_figures(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    TensorboardLogger(real_config().logger, tmp_path).log(3, {"train/loss": 0.5})
    assert list((tmp_path / "tensorboard").glob("events.*"))


def test_a_layout_that_does_not_fit_is_told_from_another_process(tmp_path: Path) -> None:
    wide = (
        "+train.env.scenario.spacing=2",
        "env.scenario.max_tries=1",
        f"hydra.run.dir={tmp_path}",
    )
    done = run(*SMALL, "model=gt_pose_gcn", "collector=async", *wide)
    assert done.returncode == 1
    folder, sentence = done.stderr.splitlines()
    assert folder == f"Run folder: {tmp_path}"
    assert sentence.startswith("No random layout of 2 objects was found in 200 draws; use fewer")
    assert json.loads((tmp_path / "status.json").read_text())["state"] == "failed"
