"""Training as a whole: it goes on after SIGKILL, refuses what is not its own, and really learns."""

from __future__ import annotations

import csv
import multiprocessing
import os
import pickle
import time
import zipfile
from pathlib import Path

import pytest
import torch
from configs import real_config
from small_network import small_network
from tensordict import TensorDict
from toys import TOYS

from sdfgcn.errors import SdfgcnError
from sdfgcn.loggers.files import NoLogger
from sdfgcn.models.q_network import QNetwork
from sdfgcn.train.replay import Replay

SMALL = (
    *("objects=household", "robot=gripper", "model=sdfgcn", "n_objects=2", "train.env.split=test"),
    *("collector=sync", "collector.pushes_per_batch=10", "budget=smoke", "budget.pushes=40"),
    *("budget.minutes=null", "budget.epsilon_pushes=35", "train.learning_starts=10"),
    *("train.utd_ratio=0.5", "train.target_interval=7", "train.log_pushes=10"),
    *("train.batch_size=8", "train.replay_capacity=30", "train.checkpoint_minutes=0"),
    "runtime.precision=float32",  # auto goes by times, and another precision gives other numbers
)
STEADY = ("pushes", "updates", "episodes", "success_rate", "return", "loss", "epsilon")


def train_in_child(overrides: tuple[str, ...], folder: Path) -> None:
    """Train and leave the network in the folder; runs in a process that can be killed."""
    from sdfgcn.sim import world
    from sdfgcn.train.training import train

    os.environ.setdefault("MUJOCO_GL", "egl")
    world.load_catalogue = lambda config, split: TOYS  # a small world is built quickly

    def keep(network: QNetwork, spent: dict[str, float]) -> None:
        torch.save(network.state_dict(), folder / "kept.pt")

    config = real_config(*overrides)
    logger = NoLogger(config.logger, folder)
    network = train(config, folder, logger, small_network, keep)
    torch.save(network.state_dict(), folder / "network.pt")


@pytest.fixture(scope="module")
def forks() -> multiprocessing.context.BaseContext:
    """Processes forked from one that has loaded everything but has no OpenGL context yet."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["sdfgcn.train.training", "small_network", "configs", "toys"])
    return context


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "train.csv").open() as file:
        return [{key: row[key] for key in STEADY} for row in csv.DictReader(file)]


def run_to_the_end(forks: multiprocessing.context.BaseContext, folder: Path) -> None:
    child = forks.Process(target=train_in_child, args=(SMALL, folder))
    child.start()
    child.join(100)
    assert child.exitcode == 0


@pytest.fixture(scope="module")
def whole(
    forks: multiprocessing.context.BaseContext, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The folder of a training that nobody disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    run_to_the_end(forks, folder)
    return folder


def test_killed_three_times_it_ends_as_if_nothing_had_happened(
    forks: multiprocessing.context.BaseContext, whole: Path, tmp_path: Path
) -> None:
    checkpoint = tmp_path / "checkpoint.zip"
    for _ in range(3):
        child = forks.Process(target=train_in_child, args=(SMALL, tmp_path))
        before = checkpoint.stat().st_mtime_ns if checkpoint.exists() else 0
        child.start()
        deadline = time.monotonic() + 100
        while not checkpoint.exists() or checkpoint.stat().st_mtime_ns == before:
            assert time.monotonic() < deadline
            time.sleep(0.005)
        child.kill()
        child.join()
        assert child.exitcode == -9
    run_to_the_end(forks, tmp_path)
    assert rows(tmp_path) == rows(whole)
    there, here = (torch.load(folder / "network.pt") for folder in (whole, tmp_path))
    assert all(torch.equal(there[key], here[key]) for key in there)
    assert {path.name for path in tmp_path.iterdir()} == {
        *("checkpoint.zip", "kept.pt", "network.pt", "train.csv"),
    }


def test_the_network_is_kept_with_each_checkpoint(whole: Path) -> None:
    there, here = (torch.load(whole / name) for name in ("network.pt", "kept.pt"))
    assert all(torch.equal(there[key], here[key]) for key in there)


def test_what_train_csv_says(whole: Path) -> None:
    table = rows(whole)
    assert [row["pushes"] for row in table] == ["10", "20", "30", "40"]
    assert [row["updates"] for row in table] == ["0", "5", "10", "15"]
    assert [float(row["epsilon"]) for row in table] == pytest.approx([0.6, 0.4, 0.2, 0.1])
    assert table[0]["loss"] == "nan"
    assert all(float(row["loss"]) > 0 for row in table[1:])


def test_a_checkpoint_is_small(whole: Path) -> None:
    assert (whole / "checkpoint.zip").stat().st_size < 400_000


def go_on(folder: Path, *overrides: str) -> None:
    from sdfgcn.train.training import train

    config = real_config(*SMALL, *overrides)
    train(config, folder, NoLogger(config.logger, folder), small_network)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5])
def test_a_damaged_checkpoint_is_named(share: float, whole: Path, tmp_path: Path) -> None:
    content = (whole / "checkpoint.zip").read_bytes()
    (tmp_path / "checkpoint.zip").write_bytes(content[: int(share * len(content))])
    with pytest.raises(SdfgcnError, match=r"checkpoint\.zip is damaged or no checkpoint"):
        go_on(tmp_path)


def test_a_flipped_byte_is_noticed(whole: Path, tmp_path: Path) -> None:
    content = bytearray((whole / "checkpoint.zip").read_bytes())
    with zipfile.ZipFile(whole / "checkpoint.zip") as archive:
        largest = max(archive.infolist(), key=lambda member: member.compress_size)
    start = largest.header_offset + 30 + len(largest.filename)
    content[start + largest.compress_size // 2] ^= 0xFF
    (tmp_path / "checkpoint.zip").write_bytes(content)
    with pytest.raises(SdfgcnError, match="damaged"):
        go_on(tmp_path)


class Attack:
    """Makes a file when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple:
        return os.mknod, (str(self.marker),)


@pytest.mark.parametrize("name", ["prefetch.pkl", "storage/other.pickle"])
def test_a_checkpoint_from_somebody_else_runs_no_code(
    name: str, whole: Path, tmp_path: Path
) -> None:
    """With either file beside its replay buffer, TorchRL would have run code."""
    path = tmp_path / "checkpoint.zip"
    path.write_bytes((whole / path.name).read_bytes())
    with zipfile.ZipFile(path, "a") as archive:
        part = next(each for each in archive.namelist() if each.endswith("-replay/state.json"))
        bad = part.replace("state.json", name)
        archive.writestr(bad, pickle.dumps(Attack(tmp_path / "marker")))
    with pytest.raises(SdfgcnError, match=f"holds '{bad}', which no checkpoint of this version"):
        go_on(tmp_path)
    assert not (tmp_path / "marker").exists()


@pytest.mark.parametrize(
    ("held", "cursor"),
    [
        ({"pixels": torch.zeros(1, 10**6)}, 0),  # for 30 transitions, 30 MB
        ({"action": torch.zeros(31)}, 0),
        ({"action": torch.zeros(1)}, 30),
        ({"action": torch.zeros(1)}, -1),
    ],
)
def test_a_buffer_of_another_size_is_refused(held: dict, cursor: int) -> None:
    replay = Replay(real_config(*SMALL))  # of 30 transitions
    writer = {**replay.state_dict()["writer"], "_cursor": cursor}
    held = TensorDict(held, batch_size=[len(next(iter(held.values())))])
    with pytest.raises(ValueError, match=r"transitions of|a cursor at"):
        replay.load_state_dict({"transitions": held, "writer": writer})


def test_a_checkpoint_is_far_smaller_than_the_most_that_is_read(whole: Path) -> None:
    """And the most grows with the buffer, which takes most of it."""
    with zipfile.ZipFile(whole / "checkpoint.zip") as archive:
        sizes = {member.filename: member.file_size for member in archive.infolist()}
    replay = sum(size for name, size in sizes.items() if "-replay/" in name)
    small, large = (
        Replay(real_config(*SMALL, f"train.replay_capacity={capacity}")).largest
        for capacity in (30, 300)
    )
    assert replay < small < 10 * replay
    assert large == 10 * small


def test_a_checkpoint_of_another_training_is_refused(whole: Path, tmp_path: Path) -> None:
    (tmp_path / "checkpoint.zip").write_bytes((whole / "checkpoint.zip").read_bytes())
    told = r"train\.discount \(0\.5 there, 0\.9 now\); use the same values"
    with pytest.raises(SdfgcnError, match=told):
        go_on(tmp_path, "train.discount=0.9")


def test_global_randomness_is_left_alone(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sdfgcn.sim.world.load_catalogue", lambda config, split: TOYS)
    (tmp_path / "checkpoint.zip").write_bytes((whole / "checkpoint.zip").read_bytes())
    (tmp_path / "train.csv").write_bytes((whole / "train.csv").read_bytes())
    before = torch.get_rng_state()
    go_on(tmp_path)  # ended already
    assert torch.equal(before, torch.get_rng_state())
    assert rows(tmp_path) == rows(whole)
