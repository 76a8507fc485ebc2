import json
import subprocess
from dataclasses import astuple, replace
from pathlib import Path

import pytest
from configs import CONF, compose_config, real_config
from omegaconf import OmegaConf

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.episodes import COLUMNS, EpisodeResult, EpisodeTable
from sdfgcn.evaluation.paper import paper_figure
from sdfgcn.evaluation.report import decimal, percent, sweep_text, text
from sdfgcn.evaluation.results import mean, summarise, t_interval, wilson
from sdfgcn.files import write_json
from sdfgcn.provenance import git_state
from sdfgcn.run_folder import RunFolder


def episode(
    index: int, success: bool = True, pushes: int = 10, error_mm: float = 20.0
) -> EpisodeResult:
    return EpisodeResult(
        episode=index,
        seed=1000 + index,
        n_objects=2,
        objects="bowl;cup",
        success=success,
        pushes=pushes,
        error_mm=error_mm,
        out_of_range=not success,
        truncated=False,
        return_=1.25,
        wall_s=0.5,
    )


# ------------------------------------------------------------------ statistics


def test_wilson_by_hand() -> None:
    # (p + z^2/2n -+ z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n), p = 0.8, n = 20, z = 1.959964
    assert wilson(16, 20) == pytest.approx((0.58398, 0.91934), abs=1e-5)
    assert wilson(0, 20) == pytest.approx((0.0, 0.16113), abs=1e-5)  # z^2 / (n + z^2)
    assert wilson(20, 20) == pytest.approx((0.83887, 1.0), abs=1e-5)


def test_t_interval_by_hand() -> None:
    # mean 40 or 20, standard deviation 10, t(0.975, 2) = 4.30265: 4.30265 * 10 / sqrt(3) = 24.8414
    assert t_interval([30.0, 40.0, 50.0]) == pytest.approx((15.1586, 64.8414), abs=1e-4)
    assert t_interval([10.0, 20.0, 30.0]) == pytest.approx((0.0, 44.8414), abs=1e-4)
    assert t_interval([10.0, 20.0, 30.0], most=35.0) == (0.0, 35.0)  # none is possible beyond
    assert t_interval([3.0, 3.0]) == (3.0, 3.0)
    assert t_interval([10.0]) is None
    assert t_interval([]) is None
    assert mean([]) is None


def test_pushes_and_error_are_means_over_successes() -> None:
    config = real_config(
        *("model=rule_based", "n_objects=2", "objects=household", "robot=gripper", "seed=7"),
        *("eval=loop_breaker", "eval.seed=8"),
    )
    episodes = [
        episode(0, pushes=10, error_mm=20.0),
        episode(1, pushes=20, error_mm=40.0),
        episode(2, success=False, pushes=90, error_mm=300.0),
        episode(3, success=False, pushes=80, error_mm=500.0),
    ]
    results = summarise(config, episodes, wall_s=12.5)
    expected = {
        "model": "rule_based",
        "env": "paper",
        "objects": "household",
        "split": "test",
        "n_objects": 2,
        "robot": "gripper",
        "scenario": "random",
        "perception": "oracle",
        "epsilon": 0.0,
        "loop_distance": 0.02,
        "seed": 7,
        "eval_seed": 8,
        "episodes": 4,
        "success_rate": 0.5,
        "pushes": 15.0,
        "error_mm": 30.0,
        "out_of_range_rate": 0.5,
        "truncated_rate": 0.0,
        "episode_seeds": [1000, 1001, 1002, 1003],
        "wall_s": 12.5,
    }
    assert {key: results[key] for key in expected} == expected
    assert results["success_rate_ci95"] == wilson(2, 4)
    # 15 -+ t(0.975, 1) * 7.0711 / sqrt(2) = 15 -+ 12.7062 * 5, cut at 0 and at 2 x 33 pushes
    assert results["pushes_ci95"] == (0.0, 66.0)
    assert results["error_mm_ci95"] == (0.0, 50.0)  # 30 -+ 127, cut at the threshold
    assert {"python", "mujoco", "torch"} <= set(results["versions"])
    json.dumps(results, allow_nan=False)


def test_nothing_succeeded() -> None:
    results = summarise(real_config(), [episode(0, success=False)], wall_s=1.0)
    empty = ("pushes", "pushes_ci95", "error_mm", "error_mm_ci95")
    assert [results[key] for key in empty] == [None] * 4
    assert results["success_rate"] == 0.0
    assert "0% [0, 79]" in text(results)


def test_paper_figures() -> None:
    figure = paper_figure("rule_based", "test", 3)
    assert figure is not None
    assert (figure.table, figure.success_rate) == ("table II", 0.69)
    assert (figure.pushes, figure.error_mm) == (59.1, 28.8)
    seen = paper_figure("rule_based", "train", 3)
    assert seen is not None
    assert (seen.table, seen.success_rate, seen.pushes) == ("table I", 0.68, 57.7)
    assert paper_figure("rule_based", "train", 4) is None
    assert paper_figure("rule_based", "test", 7) is None
    assert paper_figure("another", "test", 3) is None


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        # Table I's columns: train set, test set.
        (("pose_gcn", "train", 3, "off", 3), ("pose_gcn", "table I", 0.40, 45.1, 30.1)),
        (("gt_pose_gcn", "test", 3, "off", 3), ("gt_pose_gcn", "table I", 0.51, 44.5, 31.3)),
        (("sdf_cnn", "test", 3, "off", 3), ("sdf_cnn", "table I", 0.70, 37.3, 30.3)),
        (("separate", "test", 3, "off", 3), ("separate", "table I", 0.65, 36.2, 26.2)),
        (("sdfgcn", "train", 3, "off", 3), ("SDFGCN-fixed", "table I", 0.80, 35.0, 29.5)),
        # Table II, by curriculum.
        (("sdfgcn", "test", 3, "off", 3), ("SDFGCN-fixed", "table II", 0.80, 34.6, 31.3)),
        (("sdfgcn", "test", 6, "off", 3), ("SDFGCN-fixed", "table II", 0.0, None, None)),
        (("sdfgcn", "test", 5, "random", 3), ("SDFGCN-random", "table II", 0.60, 85.9, 27.2)),
        (("sdfgcn", "test", 4, "on", 2), ("SDFGCN-curriculum", "table II", 0.64, 48.9, 28.9)),
        # The paper has no such training, or no such evaluation.
        (("sdfgcn", "test", 5, "off", 5), None),
        (("sdfgcn", "train", 3, "on", 3), None),
        (("sdfgcn", "test", 3), None),
        (("sdf_cnn", "test", 3, "on", 3), None),
        (("sdf_cnn", "test", 4, "off", 3), None),
    ],
)
def test_paper_figures_of_learned_methods(asked: tuple, told: tuple | None) -> None:
    figure = paper_figure(*asked)
    assert (figure and astuple(figure)) == told


def test_every_method_of_table_i_is_a_model() -> None:
    ours = {"released", "push_model", "polar_q", "simulator"}
    models = {path.stem for path in (CONF / "model").glob("*.yaml")} - ours
    trained = {"curriculum": "off", "trained_objects": 3}
    assert {model for model in models if paper_figure(model, "test", 3, **trained)} == models


@pytest.mark.parametrize("model", ["sdfgcn", "released"])
def test_a_trained_network_stands_beside_its_method(model: str, tmp_path: Path) -> None:
    training = {"n_objects": 3, "curriculum.name": "on"}
    about = {"model": {"name": "sdfgcn"}, "training": training}
    write_json(tmp_path / "policy.json", about)
    config = replace(real_config(f"model={model}"), checkpoint=str(tmp_path))
    results = summarise(config, [episode(0)], wall_s=1.0)
    assert results["model"] == "sdfgcn"
    assert (results["curriculum"], results["trained_objects"]) == ("on", 3)
    assert "\nSDFGCN-curriculum (paper, table II)  -         83%" in text(results)


def test_table_stands_beside_the_paper() -> None:
    rule_based = real_config("model=rule_based")
    results = summarise(rule_based, [episode(0), episode(1, error_mm=30.0)], wall_s=1.0)
    title, head, ours, paper, _ = text(results).splitlines()
    assert title == (
        "3 scanned objects (test), model rule_based, env paper, robot ur5e, scenario random, "
        "perception oracle, epsilon 0.1, no loop distance, seed 0, eval seed 0"
    )
    assert head.index("success rate") == ours.index("100% [34, 100]") == paper.index("69%")
    assert head.index("error (mm)") == ours.index("25.0 [") == paper.index("28.8")
    assert "(paper, " not in text(results | {"scenario": "swap"})
    tight = text(results | {"success_threshold": 0.025, "checkpoint": "outputs/mine"})
    assert "(paper, " not in tight
    assert "model rule_based, checkpoint outputs/mine, env paper" in tight
    assert tight.splitlines()[0].endswith("eval seed 0, success threshold 0.025")


def test_another_agent_stands_beside() -> None:
    """A method that the paper does not have stands above the paper's best, and the rule's row."""
    config = real_config("model=push_model", "checkpoint=push_model")
    results = summarise(config, [episode(0)], wall_s=1.0)
    other = summarise(real_config("model=rule_based"), [episode(0, success=False)], wall_s=1.0)
    _, _, ours, beside, best, rule, _ = text(results, [other]).splitlines()
    assert ours.startswith("push_model (this run)") and "100% [21, 100]" in ours
    assert beside.startswith("rule_based (same scenes)") and "0% [0, 79]" in beside
    assert best.startswith("SDFGCN-curriculum (paper, table II)") and "83%" in best
    assert rule.startswith("rule_based (paper, table II)") and "69%" in rule


def test_a_sweep_has_a_column_for_what_differs() -> None:
    def row(rate: float, *overrides: str) -> dict:
        config = real_config("model=rule_based", *overrides)
        results = summarise(config, [episode(0), episode(1, success=rate == 1.0)], wall_s=1.0)
        return {**results, "overrides": ["model=rule_based", *overrides]}

    title, head, first, second, meaning = sweep_text(
        [
            row(1.0, "n_objects=2", "env.scenario.gap=0.0"),
            row(0.5, "n_objects=4", "env.scenario.gap=0.01"),
        ]
    ).splitlines()
    assert title == (
        "Model rule_based, objects scanned, robot ur5e, seed 0, env paper, split test, scenario "
        "random, perception oracle, epsilon 0.1, eval seed 0, success threshold 0.05, no loop "
        "distance"
    )
    assert head.split("  ")[0] == "n objects"
    assert "env.scenario.gap" in head and "eval" not in head
    assert first.split()[:4] == ["2", "0.0", "2", "100%"]
    assert second.split()[:4] == ["4", "0.01", "2", "50%"]
    assert head.index("success rate") == first.index("100%") == second.index("50%")
    assert meaning.startswith("Pushes and error")


def test_cells_of_a_table() -> None:
    assert percent(0.932) == "93%"
    assert percent(0.932, [0.9064, 0.951], digits=1) == "93.2% [90.6, 95.1]"
    assert decimal(26.24, (25.0, 27.36)) == "26.2 [25.0, 27.4]"
    assert percent(None) == decimal(None) == "-"


# ------------------------------------------------------------------ provenance


def test_git_state(tmp_path: Path) -> None:
    assert git_state(tmp_path) is None
    run = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"]
    (tmp_path / "file").write_text("one")
    for arguments in (["init"], ["add", "."], ["commit", "-m", "first"]):
        subprocess.run([*run, *arguments], check=True, capture_output=True)
    clean = git_state(tmp_path)
    assert clean is not None
    assert len(clean["commit"]) == 40
    assert not clean["dirty"]
    (tmp_path / "file").write_text("two")
    assert git_state(tmp_path) == clean | {"dirty": True}
    (tmp_path / "inner").mkdir()
    assert git_state(tmp_path / "inner") is None  # as a package installed inside a checkout


# ------------------------------------------------------------------ episodes.csv


def test_table_of_episodes_reads_back(tmp_path: Path) -> None:
    kept = EpisodeTable(tmp_path / "episodes.csv")
    assert kept.read() == []
    rows = [episode(2, success=False, error_mm=123.456), episode(0), episode(1)]
    for row in rows:
        kept.append(row)
    assert kept.read() == [rows[1], rows[2], rows[0]]
    head = (tmp_path / "episodes.csv").read_text().splitlines()[0]
    assert head == (
        "episode,seed,n_objects,objects,success,pushes,error_mm,out_of_range,truncated,return,wall_s"
    )
    assert head == ",".join(COLUMNS)


def test_half_a_line_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "episodes.csv"
    kept = EpisodeTable(path)
    kept.append(episode(0))
    kept.append(episode(1))
    path.write_text(path.read_text()[:-3])
    assert kept.read() == [episode(0)]


def test_what_is_no_episode_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "episodes.csv"
    EpisodeTable(path).append(episode(0))
    path.write_text(path.read_text().replace("True", "maybe"))
    with pytest.raises(SdfgcnError, match=r"not a table of episodes \(it has 'maybe'\)"):
        EpisodeTable(path).read()


# ------------------------------------------------------------------ the run folder


def status(path: Path) -> dict:
    return json.loads((path / "status.json").read_text())


def begin(
    path: Path, *episodes: EpisodeResult, overrides: tuple[str, ...] = ()
) -> list[EpisodeResult]:
    with RunFolder(path, compose_config(*overrides), overrides) as folder:
        return folder.keep(episodes)


def test_states_of_a_run(tmp_path: Path) -> None:
    path = tmp_path / "run"
    with RunFolder(path, compose_config("seed=3"), ["seed=3"]) as folder:
        running = status(path)
        assert (running["state"], running["ended"]) == ("running", None)
        assert running["pid"] > 0
        assert running["overrides"] == ["seed=3"]
        assert OmegaConf.load(path / "config.yaml").env.n_objects == 3
        folder.keep([episode(1), episode(0)])
        assert status(path)["episodes"] == 2
    assert (status(path)["state"], status(path)["error"]) == ("done", None)
    assert EpisodeTable(path / "episodes.csv").read() == [episode(0), episode(1)]
    lines = (path / "episodes.csv").read_text().splitlines()
    assert [line[0] for line in lines[1:]] == ["0", "1"]  # sorted in the file too


@pytest.mark.parametrize("error", [SdfgcnError("No room."), KeyError("x"), KeyboardInterrupt()])
def test_a_run_that_fails(tmp_path: Path, error: BaseException) -> None:
    with pytest.raises(type(error)), RunFolder(tmp_path, compose_config()) as folder:
        folder.keep([episode(0)])
        raise error
    failed = status(tmp_path)
    state = "stopped" if isinstance(error, KeyboardInterrupt) else "failed"
    assert (failed["state"], failed["episodes"]) == (state, 1)
    assert state == "stopped" or type(error).__name__ in failed["traceback"]
    assert failed["error"]
    assert "\n" not in failed["error"]
    assert not (tmp_path / "results.json").exists()


def test_goes_on_with_what_the_folder_holds(tmp_path: Path) -> None:
    begin(tmp_path, episode(0), episode(1))
    first = status(tmp_path)["wall_s"]
    with (tmp_path / "episodes.csv").open("a") as file:
        file.write("2,17")  # the process was killed here
    (tmp_path / "results.json").touch()
    free = ("eval.episodes=40", "runtime.workers=7", "viz=none", "logger=none")
    with RunFolder(tmp_path, compose_config(*free)) as folder:
        assert folder.finished == [episode(0), episode(1)]
        assert not (tmp_path / "results.json").exists()
        assert folder.wall_s >= first
        assert folder.keep([episode(2)]) == [episode(0), episode(1), episode(2)]


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("seed=1", r"seed \(0 there, 1 now\)"),
        ("env.success_threshold=0.1", r"env\.success_threshold \(0\.05 there, 0\.1 now\)"),
        ("robot=gripper", r"env\.robot"),
        ("eval.episodes=1", r"holds 2 episodes already, more than eval\.episodes=1"),
    ],
)
def test_refuses_another_experiment(tmp_path: Path, override: str, told: str) -> None:
    begin(tmp_path, episode(0), episode(1))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(SdfgcnError, match=told):
        begin(tmp_path, overrides=(override,))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_run_without_episodes_binds_nothing(tmp_path: Path) -> None:
    begin(tmp_path)
    assert begin(tmp_path, episode(0), overrides=("seed=1",)) == [episode(0)]


def test_refuses_a_folder_in_use(tmp_path: Path) -> None:
    with (
        RunFolder(tmp_path, compose_config()),
        pytest.raises(SdfgcnError, match="Another process is running"),
        RunFolder(tmp_path, compose_config()),
    ):
        pass
    assert status(tmp_path)["state"] == "done"
