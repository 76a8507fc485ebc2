"""Experiments: plans, jobs that redo nothing, checks that runs belong together, and the table."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from configs import CONF, compose_config, real_config
from omegaconf import OmegaConf

from sdfgcn.comparison import job, overview
from sdfgcn.comparison.plan import DONE, Plan, cell_name, cells, check, given
from sdfgcn.comparison.results import read
from sdfgcn.comparison.table import headline, markdown, rows
from sdfgcn.config import ComparisonConfig, MethodConfig, QNetworkConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.episodes import EpisodeResult, EpisodeTable
from sdfgcn.run_folder import is_done
from sdfgcn.validation import typed

EXPERIMENTS = sorted({path.stem for path in (CONF / "experiment").glob("*.yaml")} - {"none"})
PAPER_S = ("table1", "table2")  # the experiments of the paper
TWO_CELLS: list[dict[str, list[Any]]] = [{"n_objects": [3], "eval": ["default", "greedy"]}]


def plan_of(name: str, *overrides: str) -> Plan:
    config = real_config(f"experiment={name}")
    return Plan(config.experiment, config.budget, overrides)


def is_learned(plan: Plan, method: str) -> bool:
    return isinstance(real_config(*plan.training(method, 0)).model, QNetworkConfig)


# ------------------------------------------------------------------ plans


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_run_of_an_experiment_composes(name: str) -> None:
    plan = plan_of(name)
    for method in plan.experiment.methods:
        trained = real_config(*plan.training(method, 1))
        assert trained.seed == 1
        assert trained.budget == plan.budget
    learned = next(name for name in reversed(plan.experiment.methods) if is_learned(plan, name))
    trained = real_config(*plan.training(learned, 1))
    for cell in cells(plan.experiment):
        config = real_config(*plan.evaluation(learned, 2, cell, Path("a b")))
        assert (config.seed, config.eval.episodes) == (2, 200)
        model = config.model
        if "env.success_threshold" in cell:  # a planner knows what it is to achieve
            model = replace(model, success_threshold=trained.env.success_threshold)
        assert (model, config.checkpoint) == (trained.model, "a b")
        assert config.eval.name == cell["eval"]


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_all_methods_of_an_experiment_are_trained_alike(name: str) -> None:
    """The same pushes and updates; only the network and the number of objects differ."""
    plan = plan_of(name)
    methods = [name for name in plan.experiment.methods if is_learned(plan, name)]
    learned = [real_config(*plan.training(name, 0)) for name in methods]
    assert len({repr((c.train, c.budget, c.collector, c.her, c.augment)) for c in learned}) == 1
    assert learned[0].collector.name == "sync" or name not in PAPER_S


@pytest.mark.parametrize("name", PAPER_S)
def test_the_headline_is_the_paper_s_protocol_for_every_agent(name: str) -> None:
    experiment = plan_of(name).experiment
    main = [cell for cell in cells(experiment) if experiment.headline.items() <= cell.items()]
    assert main
    for cell in main:
        config = real_config(*plan_of(name).evaluation("rule_based", 0, cell, None))
        assert (config.eval.epsilon, config.eval.loop_distance) == (0.1, None)


def test_cells_are_all_combinations_in_order() -> None:
    experiment = ComparisonConfig(
        cells=[{"n_objects": [2, 3], "eval": ["default", "greedy"]}, {"perception": ["vision"]}]
    )
    assert [cell_name(cell) for cell in cells(experiment)] == [
        "n_objects=2,eval=default",
        "n_objects=2,eval=greedy",
        "n_objects=3,eval=default",
        "n_objects=3,eval=greedy",
        "perception=vision",
    ]


def test_both_tables_share_the_training_of_sdfgcn() -> None:
    first, second = plan_of("table1"), plan_of("table2")
    assert first.trainings("sdfgcn") == second.trainings("sdfgcn")
    others = {second.trainings(name) for name in second.experiment.methods}
    assert len(others) == len(second.experiment.methods)


def test_what_the_command_line_gives_to_every_run() -> None:
    experiment = plan_of("table1").experiment
    overrides = ["experiment=table1", "experiment.method=sdfgcn", "seed=2", "objects=household"]
    assert given(overrides, experiment) == ("objects=household",)
    with pytest.raises(SdfgcnError, match=r"perception=oracle contradicts experiment=table1"):
        given(["perception=oracle"], experiment)


def test_an_unknown_method_is_told() -> None:
    with pytest.raises(SdfgcnError, match=r"experiment.method is 'dqn'"):
        plan_of("table1").training("dqn", 0)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_headline_without_cells_is_told(name: str) -> None:
    experiment = plan_of(name).experiment
    check(experiment)
    with pytest.raises(
        SdfgcnError, match=r"experiment.headline is \{'eval': 'none'\}, but none of"
    ):
        check(replace(experiment, headline={"eval": "none"}))
    with pytest.raises(SdfgcnError, match=r"experiment.references is 'dqn', but must be one of"):
        check(replace(experiment, references=["dqn"]))


# ------------------------------------------------------------------ jobs


@pytest.fixture
def played(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The run folders of cells that a job plays; nothing is trained or simulated."""
    folders: list[Path] = []

    def run(config: Any, folder: Any) -> None:
        folders.append(folder.path)
        folder.keep([_episode(i, 3) for i in range(config.eval.episodes)])
        folder.write_results({})

    monkeypatch.setattr(job, "run_experiment", run)
    return folders


def small_plan(**changes: Any) -> Plan:
    plan = plan_of("table1", "eval.episodes=2")
    return replace(plan, experiment=replace(plan.experiment, cells=TWO_CELLS, **changes))


def test_a_job_plays_each_cell_once(played: list[Path], tmp_path: Path) -> None:
    job.run_job(small_plan(), "rule_based", 0, tmp_path)
    assert played == [tmp_path / cell_name(cell) for cell in cells(small_plan().experiment)]
    job.run_job(small_plan(), "rule_based", 0, tmp_path)
    assert len(played) == 2
    (tmp_path / "n_objects=3,eval=greedy" / "results.json").unlink()  # as if it had been killed
    job.run_job(small_plan(), "rule_based", 0, tmp_path)
    assert played[2:] == [tmp_path / "n_objects=3,eval=greedy"]


def test_a_rule_does_not_depend_on_the_training_seed(played: list[Path], tmp_path: Path) -> None:
    job.run_job(small_plan(), "rule_based", 1, tmp_path)
    assert not played
    assert (tmp_path / DONE).exists()


def test_a_cell_of_another_config_is_not_done(played: list[Path], tmp_path: Path) -> None:
    job.run_job(small_plan(), "rule_based", 0, tmp_path)
    cell = cells(small_plan().experiment)[0]
    overrides = small_plan().evaluation("rule_based", 0, cell, None)
    folder = tmp_path / cell_name(cell)
    assert is_done(folder, compose_config(*overrides))
    assert not is_done(folder, compose_config(*overrides, "eval.seed=1"))
    assert not is_done(folder, compose_config(*overrides, "eval.episodes=3"))
    assert not is_done(folder / "none", compose_config(*overrides))


# ------------------------------------------------------------------ results


def _episode(index: int, pushes: int, success: bool = True, error: float = 20.0) -> EpisodeResult:
    return EpisodeResult(index, 100 + index, 3, "a;b", success, pushes, error, False, False, 1.0, 0)


Change = Callable[[dict[str, Any]], None]


def write_cell(
    folder: Path,
    method: str,
    seed: int,
    cell: dict[str, Any],
    success: list[bool],
    change: Change = lambda results: None,
    *overrides: str,
) -> None:
    """A finished cell, with 10 pushes an episode."""
    path = folder / method / f"seed_{seed}" / cell_name(cell)
    path.mkdir(parents=True)
    evaluation = small_plan().evaluation(method, seed, cell, None)
    cfg = compose_config(*evaluation, "eval=default", "n_objects=3", *overrides)
    (path / "config.yaml").write_text(OmegaConf.to_yaml(cfg, resolve=True))
    episodes = [_episode(i, 10, ok) for i, ok in enumerate(success)]
    EpisodeTable(path / "episodes.csv").write(episodes)
    learned = method != "rule_based"
    about = {
        "budget": {"pushes": 9},
        "spent": {"pushes": 9, "updates": 4, "hours": 0.1},
        "training": {"train.discount": 0.5, "model.name": method, "seed": seed},
    }
    results = {
        **{"model": method, "split": "test", "n_objects": 3, "scenario": "random"},
        **{"env": "paper", "success_threshold": 0.05},
        **{"curriculum": "off" if learned else None, "trained_objects": 3 if learned else None},
        **{"epsilon": 0.1, "loop_distance": None, "episodes": len(episodes)},
        **{"perception": "vision", "checkpoint": "x" if learned else None},
        "training": about if learned else None,
        "episode_seeds": [episode.seed for episode in episodes],
        "git": {"commit": "a" * 40, "dirty": False},
        "versions": {"mujoco": "3"},
    }
    change(results)
    (path / "results.json").write_text(json.dumps(results))
    (path / "status.json").write_text(json.dumps({"state": "done", "episodes": len(episodes)}))


CELL = {"n_objects": 3, "eval": "default"}
EXPERIMENT = ComparisonConfig(
    name="table1",
    title="A table",
    methods={name: MethodConfig([f"model={name}"]) for name in ("rule_based", "sdfgcn")},
    cells=[{"n_objects": [3], "eval": ["default"]}],
    headline={"eval": "default"},
    references=["rule_based"],
)


def sweep(folder: Path, *overrides: str, change: Change = lambda results: None) -> Path:
    """A rule that solves 2 of 4 scenes, and a network that solves 4 and 3 with its two seeds."""
    write_cell(folder, "rule_based", 0, CELL, [True, True, False, False])
    write_cell(folder, "sdfgcn", 0, CELL, [True, True, True, True])
    write_cell(folder, "sdfgcn", 1, CELL, [True, True, True, False], change, *overrides)
    return folder


def test_matrices_of_seeds_and_scenes(tmp_path: Path) -> None:
    rule, network = read(EXPERIMENT, sweep(tmp_path), ["rule_based", "sdfgcn"], [0, 1])
    assert rule.outcomes.success.tolist() == [[True, True, False, False]]
    assert network.outcomes.success.tolist() == [[True] * 4, [True, True, True, False]]
    assert (rule.seeds, network.seeds) == ((0,), (0, 1))
    assert network.outcomes.limit == 99


def test_rows_by_hand(tmp_path: Path) -> None:
    found = read(EXPERIMENT, sweep(tmp_path), ["rule_based", "sdfgcn"], [0, 1])
    rule, network = rows(EXPERIMENT, found, np.random.default_rng(0))
    assert (rule["success_rate"], network["success_rate"]) == (0.5, 7 / 8)
    assert network["success_rate_by_seed"] == [1.0, 0.75]
    assert rule["pushes"] == 10.0
    assert rule["pushes_ci95"] is None  # from two successes
    assert rule["pushes_with_failures"] == (2 * 10 + 2 * 99) / 4
    against = network["against"]["rule_based"]
    assert against["difference"] == 3 / 8
    assert against["probability_of_improvement"] == 1.0
    assert rule["against"] == {}
    assert rule["paper"]["success_rate"] == 0.69
    within = dict(
        zip(*(network["success_within"][key] for key in ("pushes", "share")), strict=True)
    )
    assert within[1] == 0.0
    assert within[99] == 7 / 8
    assert headline(EXPERIMENT, [rule, network]) == [rule, network]
    table = markdown(EXPERIMENT, [rule, network])
    assert "| sdfgcn | 2 | 88% [" in table
    assert "| +38 [" in table
    assert "epsilon 0.1, no loop-breaker" in table


def _set(key: str, value: Any) -> Change:
    return lambda results: results.update({key: value})


def _other_training(results: dict[str, Any]) -> None:
    results["training"]["spent"]["updates"] = 5


@pytest.mark.parametrize(
    ("overrides", "change", "told"),
    [
        ((), _set("git", {"commit": "b" * 40, "dirty": False}), "evaluated at commit aaaa"),
        ((), _set("episode_seeds", [7, 8, 9, 10]), "remove the folder"),
        ((), _other_training, r"spent.updates \(4 there, 5 now\)"),
        (("env.success_threshold=0.04",), lambda results: None, "env.success_threshold"),
    ],
)
def test_what_does_not_belong_together_is_not_averaged(
    tmp_path: Path, overrides: tuple[str, ...], change: Change, told: str
) -> None:
    folder = sweep(tmp_path, *overrides, change=change)
    with pytest.raises(SdfgcnError, match=told):
        read(EXPERIMENT, folder, ["rule_based", "sdfgcn"], [0, 1])


def test_a_missing_seed_is_told(tmp_path: Path) -> None:
    with pytest.raises(SdfgcnError, match=r"sdfgcn/seed_2/.* is missing, so the table would lack"):
        read(EXPERIMENT, sweep(tmp_path), ["rule_based", "sdfgcn"], [0, 1, 2])


def test_unfinished_cells_can_be_left_out(tmp_path: Path) -> None:
    experiment = replace(EXPERIMENT, cells=[{"n_objects": [3], "eval": ["default", "greedy"]}])
    found = read(experiment, sweep(tmp_path), ["rule_based", "sdfgcn"], [0, 1], partial=True)
    assert [result.cell for result in found] == [CELL, CELL]
    table = markdown(experiment, rows(experiment, found, np.random.default_rng(0)))
    assert "Not finished: n_objects=3,eval=greedy." in table
    assert read(experiment, tmp_path, ["sdfgcn"], [0, 1, 2], partial=True) == []


def test_a_half_deleted_cell_is_told(tmp_path: Path) -> None:
    folder = sweep(tmp_path)
    path = folder / "sdfgcn" / "seed_1" / cell_name(CELL)
    (path / "results.json").write_text('{"mod')
    with pytest.raises(SdfgcnError, match=r"seed_1.* is damaged"):
        read(EXPERIMENT, folder, ["sdfgcn"], [0, 1])


# ------------------------------------------------------------------ overview


def test_the_overview_counts_jobs_and_foretells_the_end(tmp_path: Path) -> None:
    plan = small_plan(trainings=str(tmp_path / "trainings"))
    every = overview.jobs(plan, tmp_path, ["rule_based", "sdfgcn"], [0, 1])
    begun = {each: overview.progress(each, plan) for each in every}
    assert set(begun.values()) == {0.0}
    (tmp_path / "rule_based" / "seed_0").mkdir(parents=True)
    (tmp_path / "rule_based" / "seed_0" / DONE).touch()
    training = plan.trainings("sdfgcn") / "seed_0"
    training.mkdir(parents=True)
    (training / "train.csv").write_text(f"pushes,updates\n5,0\n{plan.budget.pushes // 2},3\n")
    cell = tmp_path / "sdfgcn" / "seed_1" / "n_objects=3,eval=default"
    cell.mkdir(parents=True)
    (cell / "status.json").write_text('{"state": "done"}')
    shares = {each: overview.progress(each, plan) for each in every}
    assert list(shares.values()) == [1.0, 0.0, 0.25, 0.75]
    # 2 of 4 jobs' worth in 60 minutes: as much is left.
    assert overview.line("table1", shares, begun, 3600.0) == (
        "table1: 1 of 4 jobs done, 2 running (sdfgcn seed 0 25%, sdfgcn seed 1 75%), 1 left, "
        "ETA 1 h 0 min"
    )
    assert overview.line("table1", begun, begun, 60.0).endswith("ETA unknown")


def test_typed_config_of_a_job_is_the_command_line_s() -> None:
    config = typed(compose_config("experiment=table1", "experiment.method=sdfgcn"))
    assert config.experiment.method == "sdfgcn"
