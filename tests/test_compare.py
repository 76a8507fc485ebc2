"""`python -m sdfgcn.compare`, as a user calls it."""

import csv
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import imageio_ffmpeg
import pytest
from configs import real_config
from recordings import Recording

from sdfgcn.compare import _quoted, find_agents
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.evaluate import Evaluation, evaluate
from sdfgcn.registry import RECORDERS

SMALL = (
    *("objects=household", "robot=gripper", "n_objects=2", "env.pushes_per_object=1"),
    *("eval.episodes=2", "runtime.workers=0"),
)
FILM = ("viz.width=200", "viz.height=160", "viz.push_frames=2", "viz.jump_frames=1", "viz.hold=0.1")


def run(*arguments: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "sdfgcn.compare", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        capture_output=True,
        text=True,
        timeout=240,
    )


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Its folder and stdout."""
    folder = tmp_path_factory.mktemp("compared")
    agents = "checkpoint=push_model,rule_based"
    done = run(agents, *SMALL, *FILM, f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


@pytest.mark.parametrize(
    ("title", "agent"),
    [
        ("push_model", ("model=released", "checkpoint=push_model")),
        ("rule_based", ("model=rule_based",)),
    ],
)
def test_rows_are_those_of_separate_runs(
    compared: tuple[Path, str], title: str, agent: tuple[str, ...], tmp_path: Path
) -> None:
    config = real_config(*SMALL, *agent, "viz=none")
    alone = evaluate(Evaluation(config, tmp_path, RECORDERS["none"]))
    with (compared[0] / title / "episodes.csv").open() as file:
        rows = [row | {"wall_s": ""} for row in csv.DictReader(file)]
    expected = [asdict(episode) | {"wall_s": ""} for episode in alone]
    for row, other in zip(rows, expected, strict=True):
        for key in ("seed", "objects", "success", "pushes", "error_mm", "out_of_range"):
            assert row[key] == str(other[key])


def test_a_row_for_each_agent(compared: tuple[Path, str]) -> None:
    folder, out = compared
    title, _, *rows, _, where = out.splitlines()
    assert title.startswith("2 household objects (test), env paper, robot gripper")
    assert [row.split()[:2] for row in rows] == [["push_model", "2"], ["rule_based", "2"]]
    assert where == f"Run folder: {folder}"


def test_film_and_recording_are_side_by_side(compared: tuple[Path, str]) -> None:
    drawn = compared[0] / "recordings"
    names = sorted(path.name for path in drawn.iterdir())
    assert names == ["episode_000.mp4", "episode_000.rrd"]
    frames = imageio_ffmpeg.read_frames(str(drawn / "episode_000.mp4"))
    assert next(frames)["size"] == (402, 160)
    assert len(list(frames)) == 1 + 2 * 3 + 1
    recording = Recording(drawn / "episode_000.rrd")
    assert len(recording.blueprints) == 1
    for title in ("push_model", "rule_based"):
        assert recording.pushes(f"/{title}/world/push") == [1, 2, 3]  # the last one shows the end
        assert f"/{title}/world/objects/1" in recording.entities()


def test_help() -> None:
    done = run("--help")
    assert done.returncode == 0
    assert "play the same scenes" in done.stdout
    assert "checkpoint: push_model,rule_based" in done.stdout


@pytest.mark.parametrize(
    ("entries", "overrides", "told"),
    [
        ("push_model", (), "two or more different agents"),
        ("rule_based,rule_based", (), "two or more different agents"),
        (None, (), "two or more different agents"),
        ("push_model,rule_bsed", (), r"'rule_bsed', which is neither released \(push_model, "),
        ("push_model,pose_gcn", (), "nor an agent without weights"),
        ("push_model,rule_based", ("model=sdfgcn",), "model=sdfgcn has no effect"),
        ("push_model,rule_based", ("n_objects=90",), "n_objects is 90"),
    ],
)
def test_what_cannot_be_compared_is_one_sentence(
    entries: str | None, overrides: tuple[str, ...], told: str
) -> None:
    with pytest.raises(SdfgcnError, match=told):
        find_agents(entries, overrides)


def test_an_error_has_no_traceback() -> None:
    done = run("checkpoint=push_model,nobody")
    assert done.returncode == 1
    folder, line = done.stderr.splitlines()
    assert folder.startswith("Run folder: ")
    assert line.startswith("checkpoint names 'nobody'")


def test_folders_have_short_titles_that_differ(tmp_path: Path) -> None:
    from sdfgcn.agents.policy import RELEASED

    for day in ("monday", "tuesday"):
        (tmp_path / day).mkdir()
        (tmp_path / day / "run").symlink_to(RELEASED / "push_model")
    entries = f"{tmp_path}/monday/run,{tmp_path}/tuesday/run,rule_based"
    agents = find_agents(entries, SMALL)
    assert [agent.title for agent in agents] == ["monday-run", "tuesday-run", "rule_based"]
    assert agents[0].config.checkpoint == f"{tmp_path}/monday/run"
    assert agents[2].config.checkpoint is None


def test_the_list_of_agents_is_no_sweep() -> None:
    assert _quoted("checkpoint=a,b") == "checkpoint='a,b'"
    assert [_quoted(word) for word in ("checkpoint=a", "checkpoint='a,b'", "n_objects=2,3")] == [
        *("checkpoint=a", "checkpoint='a,b'", "n_objects=2,3"),
    ]
