"""`experiments/release.py`: weights into the package, with a card from their training's files."""

import json
import sys
from pathlib import Path

import pytest
from configs import real_config

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "experiments"))

import release  # noqa: E402

from sdfgcn.agents.policy import load_network, save_policy  # noqa: E402
from sdfgcn.files import CsvTable  # noqa: E402
from sdfgcn.models import build_q_network  # noqa: E402
from sdfgcn.train.progress import columns  # noqa: E402
from sdfgcn.train.training import learning_config  # noqa: E402

ROW = {
    **{"method": "gt_pose_gcn", "n_objects": 3, "split": "test", "perception": "vision"},
    **{"env": "paper", "scenario": "random", "success_threshold": 0.05},
    **{"epsilon": 0.1, "loop_distance": None, "seeds": [0, 1], "episodes": 400},
    **{"success_rate": 0.5, "success_rate_ci95": [0.4, 0.6], "pushes": None, "pushes_ci95": None},
    **{"error_mm": 30.0, "error_mm_ci95": None, "out_of_range_rate": 0.25},
}


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """The folder of a training, and a table with a row of it."""
    config = real_config("model=gt_pose_gcn", "seed=4")
    about = {
        **{"budget": {"pushes": 90}, "spent": {"pushes": 90, "updates": 7, "hours": 0.25}},
        **{"seed": 4, "git": {"commit": "c" * 40, "dirty": False}},
        "training": learning_config(config),
    }
    folder = tmp_path / "training"
    folder.mkdir()
    save_policy(folder / "policy", build_q_network(config.model, 8, 3, 96, 0), about)
    row = dict.fromkeys(columns(), 0) | {
        "pushes": 90,
        "success_rate": 0.75,
        "out_of_range_rate": "",
    }
    CsvTable(folder / "train.csv", columns()).write([row])
    (tmp_path / "table1.json").write_text(json.dumps([ROW, ROW | {"method": "sdfgcn"}]))
    return folder


def run(trained: Path, *options: str) -> int:
    folder = trained.parent
    where = ("--results", str(folder), "--weights", str(folder / "weights"), "--table", "table1")
    return release.main([*options, str(trained), *where])


def test_weights_and_card(trained: Path) -> None:
    assert run(trained, "gt_pose_gcn") == 0
    released = trained.parent / "weights" / "gt_pose_gcn"
    network, about = load_network(released)
    assert (about["seed"], network.max_objects) == (4, 3)
    card = (released / "README.md").read_text()
    assert "seed 4, commit cccccccccc; 90 pushes, 7 updates of 32 transitions, 0.25 hours" in card
    assert "| 90 | 0 | 0.00 | 0 | 75% | - | 0 |" in card
    conditions = "| paper | random | 0.05 | 3 | test | vision | 0.1 | - |"
    assert f"{conditions} 2 | 400 | 50% [40, 60] | - | 30.0 | 25% |" in card
    assert card.count("| 3 | test |") == 1


def test_a_release_has_a_checksum(trained: Path) -> None:
    file = trained / "policy" / "policy.json"
    about = json.loads(file.read_text())
    checksum = about.pop("sha256")
    file.write_text(json.dumps(about))  # as older ones are
    assert run(trained, "gt_pose_gcn") == 0
    released = trained.parent / "weights" / "gt_pose_gcn" / "policy.json"
    assert json.loads(released.read_text())["sha256"] == checksum


def test_damaged_weights_are_not_released(
    trained: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights = trained / "policy" / "weights.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1] + b"?")
    assert run(trained, "gt_pose_gcn") == 1
    assert "does not have the checksum" in capsys.readouterr().err
    assert not (trained.parent / "weights").exists()


def test_what_is_refused(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(trained, "other") == 1
    assert "have no rows of other" in capsys.readouterr().err
    about = json.loads((trained / "policy" / "policy.json").read_text())
    (trained / "policy" / "policy.json").write_text(json.dumps(about | {"budget": None}))
    assert run(trained, "gt_pose_gcn") == 1
    assert "is of an unfinished training" in capsys.readouterr().err
    assert not (trained.parent / "weights").exists()


def test_a_damaged_curve_is_refused(trained: Path, capsys: pytest.CaptureFixture[str]) -> None:
    curve = trained / "train.csv"
    curve.write_text(curve.read_text() + "1,2\n")
    assert run(trained, "gt_pose_gcn") == 1
    assert "train.csv is not a table with the columns pushes," in capsys.readouterr().err
