"""`python run.py -m experiment=...`: from nothing to the table, and again after a kill."""

import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from configs import real_config

from sdfgcn.objects.catalogue import load_catalogue

ROOT = Path(__file__).parents[1]
# One network and the rule, a few pushes each.
SMALL = (
    *("experiment=table1", "experiment.method=rule_based,gt_pose_gcn", "budget=smoke"),
    *(
        "budget.pushes=20",
        "collector.pushes_per_batch=20",
        "train.learning_starts=10",
        "objects=household",
        "env.max_objects=3",
    ),
    *("eval.episodes=1", "experiment.headline.perception=oracle"),
    "experiment.cells=[{eval.split:[test],eval:[default],perception:[oracle]}]",
)
PLUGINS = {"submitit_local": "hydra_plugins.hydra_submitit_launcher"}


def run(folder: Path, *overrides: str) -> subprocess.CompletedProcess:
    trainings = f"experiment.trainings={folder / 'trainings'}"
    return command(*SMALL, trainings, f"hydra.sweep.dir={folder}", *overrides)


def command(*overrides: str) -> subprocess.CompletedProcess:
    done = subprocess.run(
        [sys.executable, ROOT / "run.py", "-m", *overrides],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert "Traceback" not in done.stdout + done.stderr, done.stderr
    return done


@pytest.fixture(scope="module", autouse=True)
def household() -> None:
    """Build the cache outside the jobs, which would both do it."""
    config = real_config("objects=household")
    for split in ("train", "test"):
        load_catalogue(config.env.objects, split)


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess]:
    folder = tmp_path_factory.mktemp("sweep")
    return folder, run(folder)


def test_from_nothing_to_the_table(sweep: tuple[Path, subprocess.CompletedProcess]) -> None:
    folder, done = sweep
    assert done.returncode == 0, done.stderr
    assert "| rule_based | 1 |" in done.stdout
    assert "2 of 2 jobs done" in done.stderr
    rows = json.loads((folder / "table1.json").read_text())
    assert [row["method"] for row in rows] == ["rule_based", "gt_pose_gcn"]
    assert rows[1]["training"][0]["spent"]["pushes"] == 20
    for figure in ("success", "within", "training"):
        assert (folder / f"table1_{figure}.png").stat().st_size > 5000


@pytest.mark.parametrize("launcher", ["basic", "submitit_local"])
def test_again_only_what_is_missing(
    launcher: str, sweep: tuple[Path, subprocess.CompletedProcess]
) -> None:
    """As if it had been killed in the rule's cell, after everything else was finished."""
    if launcher in PLUGINS and find_spec(PLUGINS[launcher]) is None:
        pytest.skip("not installed")
    folder, _ = sweep
    (missing,) = folder.glob("rule_based/seed_0/eval*")
    shutil.rmtree(missing)
    files = (*folder.glob("trainings/*/seed_0/checkpoint*"), *folder.glob("gt*/seed_0/eval*/*"))
    before = {path: path.stat().st_mtime_ns for path in files}
    assert before
    done = run(folder, f"hydra/launcher={launcher}")
    assert done.returncode == 0, done.stderr
    assert (missing / "results.json").exists()
    assert {path: path.stat().st_mtime_ns for path in files} == before
    assert json.loads((folder / "table1.json").read_text())


def test_several_experiments_at_once_are_refused(tmp_path: Path) -> None:
    """Hydra drops the grids of both."""
    done = command("experiment=table1,table2", f"hydra.sweep.dir={tmp_path}")
    assert done.returncode == 1
    assert "run one experiment a call: python run.py -m experiment=table" in done.stderr
