import csv
import dataclasses
import math
import os
import subprocess
import sys
import time
import traceback
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch
from configs import real_config
from odd_worlds import dying_world
from point_world import Endless, Notes, PointWorld
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from sdfgcn.agents import build_agent
from sdfgcn.agents.epsilon_greedy import EpsilonGreedy, QAgent
from sdfgcn.config import Config
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.episodes import EpisodeResult
from sdfgcn.evaluation.evaluate import Evaluation, HeldOutEvaluation, evaluate, watch
from sdfgcn.evaluation.play import episode_seeds, play_episode
from sdfgcn.registry import LOGGERS, RECORDERS


def config(*overrides: str) -> Config:
    own = ("model=rule_based", "runtime.workers=0", "viz.episodes=0", "eval.episodes=4")
    return real_config(*own, *overrides)


def point_world(tmp_path: Path, *overrides: str) -> Evaluation:
    return Evaluation(config(*overrides), tmp_path / "recordings", Notes, PointWorld)


def without_time(episodes: list[EpisodeResult]) -> list[EpisodeResult]:
    rows = [dataclasses.replace(episode, wall_s=0.0) for episode in episodes]
    return sorted(rows, key=lambda row: row.episode)


class PlacedWorld(PointWorld):
    """Two points: one 0.19 m left of its goal, one at its goal, 0.01 m off."""

    def reset_episode(self, seed):
        start, goal = [[-0.19, 0.0], [0.1, 0.1]], [[0.0, 0.0], [0.1, 0.11]]
        return self.place(np.array(start), np.array(goal), seed)


def play(world: PointWorld, *overrides: str, **options) -> EpisodeResult:
    agent = build_agent(config("eval=greedy", *overrides), np.random.default_rng(0))
    return play_episode(world, agent, episode=5, seed=11, **options)


def test_episode_by_hand() -> None:
    # 0.19 -> 0.13 -> 0.07 -> 0.01 m: three pushes of 0.06 m, each rewarded with 1.
    episode = play(PlacedWorld(config("n_objects=2").env))
    assert (episode.episode, episode.seed) == (5, 11)
    assert (episode.n_objects, episode.objects) == (2, "apple;brick")
    assert (episode.success, episode.truncated, episode.out_of_range) == (True, False, False)
    assert (episode.pushes, episode.return_) == (3, 3.0)
    assert episode.error_mm == pytest.approx((10 + 10) / 2)
    assert 0 < episode.wall_s < 5


class ToTheRight(TensorDictModuleBase):
    """Values a push of the first object along +x most; that of the second is worth `second`."""

    in_keys = ("scene",)
    out_keys = ("action_value",)

    def __init__(self, second: float) -> None:
        super().__init__()
        self.second = second

    def forward(self, td: TensorDict) -> TensorDict:
        values = torch.zeros_like(td["action_mask"], dtype=torch.float32)
        values[0], values[8] = 1.0, self.second
        return td.set("action_value", values)


def test_a_network_in_training_is_evaluated_greedily_on_held_out_scenes() -> None:
    own = ("n_objects=2", "train.eval_episodes=3", "env.pushes_per_object=5", "eval.epsilon=1.0")
    with closing(HeldOutEvaluation(config(*own), PlacedWorld)) as evaluation:
        # As in the episode above; no random push, whatever eval.epsilon says.
        figures = evaluation(ToTheRight(second=0.0))
        assert figures == {
            "episodes": 3.0,
            "success_rate": 1.0,
            "episode_pushes": 3.0,
            "error_mm": pytest.approx(10.0),
            "out_of_range_rate": 0.0,
        }
        # The second point goes 10 times 0.06 m away, to the step limit of 5 pushes an object.
        figures = evaluation(ToTheRight(second=2.0))
        assert (figures["success_rate"], figures["episode_pushes"]) == (0.0, 10.0)
        assert figures["error_mm"] == pytest.approx((190 + 1000 * np.hypot(0.6, 0.01)) / 2, abs=0.1)


def test_step_limit_truncates() -> None:
    episode = play(PlacedWorld(config("n_objects=2", "env.pushes_per_object=1").env))
    assert (episode.success, episode.truncated, episode.pushes) == (False, True, 2)
    assert episode.error_mm == pytest.approx((70 + 10) / 2)


class StuckWorld(PlacedWorld):
    """No push moves anything."""

    def step(self, td):
        position = self.position.copy()
        td = super().step(td)
        self.position = position
        td["next"].update(self.observe())
        return td


class Pushes(Notes):
    """The row and the direction of every push."""

    def step(self, step):
        self.lines.append((step.push.row, step.push.direction))


def pushes_where_nothing_moves(tmp_path: Path, *overrides: str) -> list[tuple[int, int]]:
    """16 of them, one for each object and direction."""
    world = StuckWorld(config("n_objects=2", "env.pushes_per_object=8").env)
    with Pushes(tmp_path / "pushes", world.config) as recorder:
        episode = play(world, *overrides, recorder=recorder)
        start, *pushes = recorder.lines
        recorder.lines = []
    assert (start, episode.pushes, episode.truncated) == ("start", 16, True)
    return pushes


def test_a_rule_that_is_stuck_tries_every_push_if_loops_are_broken(tmp_path: Path) -> None:
    assert pushes_where_nothing_moves(tmp_path, "eval.loop_distance=null") == [(0, 0)] * 16
    tried = pushes_where_nothing_moves(tmp_path, "eval.loop_distance=0.005")
    assert [row for row, _ in tried] == [0] * 8 + [1] * 8  # the one away from its goal first
    nearest_first = [{0}, {1, 7}, {2, 6}, {3, 5}, {4}]
    assert tried[0] == (0, 0)
    assert [{k for _, k in tried[a:b]} for a, b in ((0, 1), (1, 3), (3, 5), (5, 7), (7, 8))] == (
        nearest_first
    )
    assert len(set(tried)) == 16


def test_a_rule_under_epsilon_now_and_then_pushes_at_random(tmp_path: Path) -> None:
    some = ("eval.epsilon=0.5", "eval.loop_distance=null")
    taken = pushes_where_nothing_moves(tmp_path, *some)
    assert 3 <= taken.count((0, 0)) <= 13
    assert taken == pushes_where_nothing_moves(tmp_path, *some)  # drawn from the agent's generator


def test_recorder_gets_the_start_and_every_push(tmp_path: Path) -> None:
    world = PlacedWorld(config("n_objects=2").env)
    with Notes(tmp_path / "notes", world.config) as recorder:
        recorded = play(world, recorder=recorder)
    assert recorder.lines == ["start", "push 1", "push 2", "push 3"]
    assert world.record
    assert without_time([play(world)]) == without_time([recorded])
    assert not world.record


def test_seeds_are_fixed_and_differ() -> None:
    assert episode_seeds(0, 0)[0] == 4088532484  # pinned: a change would alter every result
    seeds = {episode_seeds(seed, episode)[0] for seed in range(5) for episode in range(200)}
    assert len(seeds) == 1000
    assert max(seeds) < 2**32
    draws = {episode_seeds(seed, 0)[1].random() for seed in range(5)}
    assert len(draws) == 5


def test_scenes_follow_from_the_seed_of_the_evaluation(tmp_path: Path) -> None:
    plain, trained_anew, other = (
        list(evaluate(point_world(tmp_path, *overrides)))
        for overrides in ((), ("seed=1",), ("eval.seed=1",))
    )
    assert without_time(trained_anew) == without_time(plain)
    assert {episode.seed for episode in other}.isdisjoint(episode.seed for episode in plain)


def test_first_episodes_are_recorded(tmp_path: Path) -> None:
    episodes = list(evaluate(point_world(tmp_path, "viz.episodes=2")))
    notes = {path.name: path.read_text().splitlines() for path in tmp_path.glob("*/*")}
    assert sorted(notes) == ["episode_000", "episode_001"]
    for index in range(2):
        assert len(notes[f"episode_00{index}"]) == 1 + episodes[index].pushes
    plain = list(evaluate(point_world(tmp_path)))
    assert without_time(plain) == without_time(episodes)


def test_finished_episodes_are_left_out(tmp_path: Path) -> None:
    every = list(evaluate(point_world(tmp_path)))
    rest = list(evaluate(point_world(tmp_path), finished=[0, 2]))
    assert [episode.episode for episode in rest] == [1, 3]
    assert without_time(rest) == without_time([every[1], every[3]])
    assert not list(evaluate(point_world(tmp_path, "runtime.workers=2"), finished=range(4)))


def test_a_worker_that_breaks_stops_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = tmp_path / "first"
    first.touch()
    monkeypatch.setenv("FIRST_EPISODE", str(first))
    evaluation = dataclasses.replace(
        point_world(tmp_path, "runtime.workers=2", "eval.episodes=5"), make_env=Endless
    )
    begun = time.monotonic()
    with pytest.raises(FloatingPointError, match="the simulation broke") as raised:
        list(evaluate(evaluation))
    assert time.monotonic() - begun < 50  # the others would play on for ever
    assert "in reset_episode" in "".join(traceback.format_exception(raised.value))


def test_a_worker_that_dies_is_told(tmp_path: Path) -> None:
    evaluation = Evaluation(config("runtime.workers=1"), tmp_path, RECORDERS["none"], dying_world)
    with pytest.raises(SdfgcnError, match=r"worker process died.*runtime\.workers"):
        list(evaluate(evaluation))


def test_workers_end_with_a_main_process_that_is_killed(tmp_path: Path) -> None:
    script = Path(__file__).with_name("odd_worlds.py")
    path = os.pathsep.join([str(script.parents[1]), os.environ.get("PYTHONPATH", "")])
    main = subprocess.Popen(
        [sys.executable, script, tmp_path],
        env=os.environ | {"PYTHONPATH": path},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert main.stdout is not None
    assert [main.stdout.readline() for _ in range(2)] == ["asleep\n"] * 2
    main.kill()
    main.communicate(timeout=30)  # comes back once the workers have closed their end, too


OPTIONAL_PACKAGES = {"tensorboard", "wandb"}  # loggers that are extras of the same name


@pytest.mark.parametrize("name", sorted(LOGGERS))
def test_watching_passes_episodes_on_and_logs_them(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in OPTIONAL_PACKAGES:
        pytest.importorskip(name)
    monkeypatch.setenv("WANDB_MODE", "offline")
    episodes = list(evaluate(point_world(tmp_path)))
    done, rest = episodes[:1], episodes[1:]
    logger = LOGGERS[name](real_config(f"logger={name}").logger, tmp_path)
    assert list(watch(rest, done, total=4, logger=logger)) == rest
    if name == "csv":
        with (tmp_path / "metrics.csv").open() as file:
            rows = list(csv.DictReader(file))
        rates = [float(row["value"]) for row in rows if row["name"] == "success_rate"]
        so_far = np.cumsum([episode.success for episode in episodes]) / np.arange(1, 5)
        assert rates == pytest.approx(so_far[1:].tolist())
        assert sorted({row["step"] for row in rows}) == ["2", "3", "4"]


class Broken(TensorDictModuleBase):
    """Values every push by one number, and with `at`, from that push of an episode on."""

    in_keys = ("pushes",)
    out_keys = ("action_value",)

    def __init__(self, value: float, at: int = 0) -> None:
        super().__init__()
        self.value, self.at = value, at

    def forward(self, td: TensorDict) -> TensorDict:
        wrong = int(td["pushes"]) >= self.at
        td["action_value"] = torch.full(td["action_mask"].shape, self.value if wrong else 0.0)
        return td


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("at", [0, 2])
def test_q_values_that_are_not_finite_name_the_episode(value: float, at: int) -> None:
    world = PointWorld(config("n_objects=2").env)
    agent = EpsilonGreedy(QAgent(Broken(value, at)), np.random.default_rng(0), 0.0, None)
    told = rf"^The Q-values of push {at + 1} in episode 5 \(seed 11\) are not finite:"
    with pytest.raises(SdfgcnError, match=told):
        play_episode(world, agent, episode=5, seed=11)


def test_only_legal_pushes_need_a_finite_value() -> None:
    class Masking(Broken):
        def forward(self, td: TensorDict) -> TensorDict:
            td["action_value"] = torch.where(td["action_mask"], 0.0, -torch.inf)
            return td

    world = PointWorld(config("n_objects=2", "env.pushes_per_object=1").env)
    agent = EpsilonGreedy(QAgent(Masking(0.0)), np.random.default_rng(0), 0.0, None)
    assert play_episode(world, agent, episode=0, seed=11).pushes > 0
