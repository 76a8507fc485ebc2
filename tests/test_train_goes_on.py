"""Short trainings in this process: stopped and gone on with, evaluated on the way, and others."""

from __future__ import annotations

import csv
import json
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from configs import CONF, real_config
from small_network import small_network
from tensordict import TensorDict
from toys import TOYS

from sdfgcn.config import Config
from sdfgcn.loggers.files import CsvLogger, NoLogger
from sdfgcn.models.q_network import QNetwork
from sdfgcn.train.held_out import FIGURES
from sdfgcn.train.learner import Learner
from sdfgcn.train.progress import read_curve
from sdfgcn.train.trainer import Trainer
from sdfgcn.train.training import BuildNetwork, build_trainer, q_network, train

SMALL = (
    *("objects=household", "robot=gripper", "model=sdfgcn", "n_objects=2", "train.env.split=test"),
    *("collector=sync", "collector.pushes_per_batch=5", "budget=smoke", "budget.minutes=null"),
    *("budget.epsilon_pushes=35", "train.learning_starts=5", "train.utd_ratio=0.5"),
    *("train.target_interval=7", "train.batch_size=8", "train.replay_capacity=60"),
    *("train.checkpoint_minutes=60", "runtime.precision=float32"),
)

Weights = dict[str, torch.Tensor]


@pytest.fixture(autouse=True)
def small_world(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sdfgcn.sim.world.load_catalogue", lambda config, split: TOYS)


def weights_of(folder: Path, pushes: int, *overrides: str, **options: object) -> Weights:
    """Train up to so many pushes, from the folder's checkpoint if there is one."""
    config = real_config(*SMALL, f"budget.pushes={pushes}", *overrides)
    return train(
        config, folder, NoLogger(config.logger, folder), small_network, **options
    ).state_dict()


def trainer_of(config: Config, folder: Path, build: BuildNetwork = small_network) -> Trainer:
    logger = NoLogger(config.logger, folder)
    torch.manual_seed(config.seed)
    return build_trainer(config, folder, logger, build, lambda network, spent: None, None)


def same(there: Weights, here: Weights) -> bool:
    return all(torch.equal(there[key], here[key]) for key in there)


# ------------------------------------------------------------------ hindsight


HINDSIGHTS = sorted(path.stem for path in (CONF / "her").glob("*.yaml"))
CURRICULA = sorted(path.stem for path in (CONF / "curriculum").glob("*.yaml"))
COUNTS = {
    "many": ("curriculum.counts=[3,4]",),  # TOYS are four
    "on": (  # every push succeeds; the seventh at a count opens the next
        *("curriculum.counts=[1,2,3]", "curriculum.window=7", "curriculum.success_threshold=0.0"),
        *("curriculum.confidence=0.5", "curriculum.newest_share=1.0"),
        "+train.env.success_threshold=1.0",
    ),
}


@pytest.mark.parametrize(
    ("her", "curriculum"),
    sorted({*((her, "off") for her in HINDSIGHTS), *(("future", each) for each in CURRICULA)}),
)
def test_stopped_and_gone_on_with_is_the_same(her: str, curriculum: str, tmp_path: Path) -> None:
    """Weights and rows, also if the stop is in an episode that ends after it."""
    how = (f"her={her}", f"curriculum={curriculum}", *COUNTS.get(curriculum, ()))
    how = (*how, "train.env.pushes_per_object=3", "train.log_pushes=5")
    for folder in ("whole", "parts"):
        (tmp_path / folder).mkdir()
    whole = weights_of(tmp_path / "whole", 20, *how)
    early = weights_of(tmp_path / "parts", 10, *how)
    stop = curve_of(tmp_path / "parts")[-1]
    in_finished = float(stop["episodes"]) * float(stop["episode_pushes"])
    assert (in_finished == 10.0) == (curriculum == "on")
    assert not same(whole, early)
    assert same(whole, weights_of(tmp_path / "parts", 20, *how))
    rows = curve_of(tmp_path / "whole")
    assert rows == curve_of(tmp_path / "parts")
    assert [row["pushes"] for row in rows] == ["5", "10", "15", "20"]
    counts = [row["n_objects"] for row in rows]
    assert counts == (["1", "2", "2", "3"] if curriculum == "on" else counts[:1] * 4)


def curve_of(folder: Path) -> list[dict[str, str]]:
    """The rows of `train.csv` without what depends on time."""
    timed = {"seconds", "pushes_per_s", "updates_per_s"}
    return [
        {k: v for k, v in row.items() if k not in timed} for row in read_curve(folder / "train.csv")
    ]


def test_a_push_model_goes_on_exactly(tmp_path: Path) -> None:
    """Supervised training too gives the same weights, whether it was stopped or not."""
    model = ("model=push_model", "curriculum=off", "train.max_utd_ratio=1.0")

    def trained(folder: Path, pushes: int) -> Weights:
        folder.mkdir(exist_ok=True)
        config = real_config(*SMALL, *model, f"budget.pushes={pushes}")
        return train(config, folder, NoLogger(config.logger, folder), q_network).state_dict()

    whole = trained(tmp_path / "whole", 35)
    early = trained(tmp_path / "parts", 15)
    assert not same(whole, early)
    assert same(whole, trained(tmp_path / "parts", 35))


@pytest.mark.parametrize(
    ("collector", "changed"), [("sync", "sync"), ("sync", "async"), ("async", "sync")]
)
def test_only_one_process_goes_on_with_its_episode(
    collector: str, changed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Others begin new ones: nothing of the old one is counted to them."""
    config = real_config(*SMALL, "her=future", "budget.pushes=10")
    first = trainer_of(config, tmp_path)
    with closing(first):
        first.run()
        if collector == "async":
            monkeypatch.setattr(first._collector, "state", dict)
            first._save()
    monkeypatch.setattr("sdfgcn.train.training.build_collector", lambda spec: None)
    second = trainer_of(
        replace(config, collector=replace(config.collector, name=changed)), tmp_path
    )
    goes_on = collector == changed == "sync"
    assert bool(second._hindsight._carried) == goes_on
    assert (second._progress._carried != 0.0) == goes_on


# ------------------------------------------------------------------ precision


def test_precision_is_chosen_once_a_run_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a run was cut off before its first checkpoint."""
    monkeypatch.setattr("sdfgcn.train.training.build_collector", lambda spec: None)

    def chosen(folder: Path, fastest: str, precision: str = "auto") -> str | None:
        folder.mkdir(exist_ok=True)
        monkeypatch.setattr(Learner, "_seconds", lambda self, name, batch: name != fastest)
        config = real_config(*SMALL, f"runtime.precision={precision}")
        trainer = trainer_of(config, folder)
        trainer._choose_precision(TensorDict(batch_size=[8]))
        return trainer._learner.precision

    kept = tmp_path / "first" / "precision.json"
    assert chosen(kept.parent, fastest="bfloat16") == "bfloat16"
    assert json.loads(kept.read_text()) == {"precision": "bfloat16"}
    assert chosen(kept.parent, fastest="float32") == "bfloat16"
    assert chosen(kept.parent, fastest="bfloat16", precision="float32") == "float32"
    assert json.loads(kept.read_text()) == {"precision": "bfloat16"}
    assert chosen(tmp_path / "second", fastest="float32") == "float32"
    assert chosen(tmp_path / "third", fastest="float32", precision="bfloat16") == "bfloat16"
    assert not (tmp_path / "third" / "precision.json").exists()


# ------------------------------------------------------------------ the curve of held-out success


class Judge:
    """Stands for the played episodes: draws random numbers as they do, and spoils its network."""

    def __init__(self) -> None:
        self.judged: list[Weights] = []

    def __call__(self, network: QNetwork) -> dict[str, float]:
        self.judged.append({key: value.clone() for key, value in network.state_dict().items()})
        torch.rand(7)
        with torch.no_grad():
            for parameter in network.parameters():
                parameter.zero_()
        return {name: float(len(self.judged)) for name in FIGURES}


def curve(folder: Path) -> list[tuple[int, float]]:
    with (folder / "eval.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["pushes", *FIGURES]
    return [(int(row["pushes"]), float(row["success_rate"])) for row in rows]


def test_a_curve_of_held_out_success(tmp_path: Path) -> None:
    """A row whenever another 10 pushes have been made, and the training is none the wiser."""
    for folder in ("plain", "judged"):
        (tmp_path / folder).mkdir()
    plain = weights_of(tmp_path / "plain", 25, "train.eval_pushes=10")  # nobody to play
    assert not (tmp_path / "plain" / "eval.csv").exists()
    judge = Judge()
    folder = tmp_path / "judged"
    assert same(plain, weights_of(folder, 25, "train.eval_pushes=10", evaluate=judge))
    assert curve(folder) == [(10, 1.0), (20, 2.0)]
    assert not same(*judge.judged)


def test_the_curve_goes_on_from_a_checkpoint(tmp_path: Path) -> None:
    """Rows of pushes that are made again are done again, once, and at the same weights."""
    judge = Judge()
    options = {"evaluate": judge}
    weights_of(tmp_path, 15, "train.eval_pushes=10", **options)
    early = (tmp_path / "checkpoint.zip").read_bytes()
    weights_of(tmp_path, 30, "train.eval_pushes=10", **options)
    assert curve(tmp_path) == [(10, 1.0), (20, 2.0), (30, 3.0)]
    (tmp_path / "checkpoint.zip").write_bytes(early)
    weights_of(tmp_path, 30, "train.eval_pushes=10", **options)
    assert curve(tmp_path) == [(10, 1.0), (20, 4.0), (30, 5.0)]
    assert same(judge.judged[1], judge.judged[3])
    assert same(judge.judged[2], judge.judged[4])


def test_the_logger_hears_of_the_curve(tmp_path: Path) -> None:
    config = real_config(*SMALL, "budget.pushes=10", "train.eval_pushes=10")
    train(config, tmp_path, CsvLogger(config.logger, tmp_path), small_network, evaluate=Judge())
    with (tmp_path / "metrics.csv").open() as file:
        told = [row for row in csv.DictReader(file) if row["name"].startswith("eval/")]
    assert {row["step"] for row in told} == {"10"}
    assert {row["name"] for row in told} == {f"eval/{name}" for name in FIGURES}


# ------------------------------------------------------------------ directions


def test_trains_with_16_directions(tmp_path: Path) -> None:
    config = real_config(
        *(*SMALL, "model=pose_gcn", "env.push.directions=16", "augment.probability=0.5"),
        *("train.epsilon_start=1.0", "train.epsilon_end=1.0", "budget.pushes=25"),
    )
    trainer = trainer_of(config, tmp_path, q_network)
    before = {key: value.clone() for key, value in trainer._learner.network.state_dict().items()}
    with closing(trainer):
        trainer.run()
        batch = trainer._replay.sample()
    assert trainer._learner.updates == 10
    assert not same(before, trainer._learner.network.state_dict())
    taken = trainer._replay.buffer[:]["action"] % 16
    assert len(set(taken.tolist())) > 8
    assert batch["action_mask"].shape == (8, 2 * 16)
    assert trainer.averaged(batch)["action_value"].shape == (8, 2 * 16)
