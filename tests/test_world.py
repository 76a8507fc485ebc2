"""The environment in a world of a few lines, without MuJoCo and without truth: as on a real table.

Everything goes by the centres that were seen, so every number here can be worked out by hand.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import torch
from recordings import Recording
from square_world import Points, SquarePerception, SquareWorld, square_config
from torchrl.envs.utils import check_env_specs
from toys import act

from sdfgcn.agents import build_agent
from sdfgcn.config import Config
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.evaluate import play_episode
from sdfgcn.registry import PERCEPTIONS, RECORDERS

RIGHT, UP, LEFT = 0, 2, 4
START, GOAL = [(-0.12, 0.0), (0.1, 0.1)], [(0.0, 0.0), (0.1, 0.1)]


@pytest.fixture(autouse=True)
def squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """The perception, registered for the length of a test."""
    monkeypatch.setitem(PERCEPTIONS._builders, "squares", SquarePerception)


@pytest.fixture
def config() -> Config:
    return square_config()


def build(config: Config, start: Points, goal: Points) -> RearrangementEnv:
    return RearrangementEnv(config.env, seed=0, world=SquareWorld(config.env, start, goal))


@pytest.fixture
def env(config: Config) -> Iterator[RearrangementEnv]:
    with closing(build(config, START, GOAL)) as env:
        yield env


def test_specs(env):
    check_env_specs(env)


def test_observation_is_what_was_seen(env):
    td = env.reset_episode(3)
    assert td["scene", "node_mask"].tolist() == [True, True, False, False]
    assert td["matched"].tolist() == [True, True, False, False]
    np.testing.assert_allclose(td["scene", "center"][:2], START, atol=1e-6)
    np.testing.assert_allclose(td["goal", "center"][:2], GOAL, atol=1e-6)
    assert torch.equal(td["scene", "position"], td["scene", "center"])
    assert torch.equal(td["goal", "position"], td["goal", "center"])
    assert td["scene"].masks.sum(dim=(1, 2)).tolist() == [36, 36, 0, 0]
    start = env.episode_start
    assert (start.seed, start.n_objects, start.truth) == (3, 2, None)
    assert start.start.poses is None and start.goal.poses is None


def test_progress_and_success_by_the_centres_that_were_seen(env):
    td = env.reset_episode(0)
    td = act(env, td, RIGHT)
    # From 12 cm to 6 cm: 30 * 0.06 for the progress, -0.02 for the push.
    assert td["reward"].item() == pytest.approx(1.78, abs=1e-5)
    np.testing.assert_allclose(env.last_step.distances, [0.06, 0.0, np.nan, np.nan], atol=1e-6)
    assert not td["success"].item() and not td["done"].item()  # 6 cm is more than 5 cm
    td = act(env, td, RIGHT)
    assert td["reward"].item() == pytest.approx(1.78 + 10.0, abs=1e-5)
    assert td["success"].item() and td["terminated"].item()
    assert not td["truncated"].item() and not td["out_of_range"].item()
    assert env.last_step.after.poses is None


def test_success_within_the_threshold(config):
    # 10.5 cm away: 4.5 cm are left after one push.
    with closing(build(config, [(-0.105, 0.0)], [(0.0, 0.0)])) as env:
        td = act(env, env.reset_episode(0), RIGHT)
        assert env.last_step.distances[0] == pytest.approx(0.045, abs=1e-6)
        assert td["success"].item()
    # 11.5 cm away: 5.5 cm.
    with closing(build(config, [(-0.115, 0.0)], [(0.0, 0.0)])) as env:
        td = act(env, env.reset_episode(0), RIGHT)
        assert not td["success"].item()


def test_out_of_range_by_the_centres_that_were_seen(config):
    # The allowed region ends at 15 cm; from 12 cm to 18 cm is a progress of -1.8, floored.
    with closing(build(config, [(0.12, 0.0)], [(0.0, 0.0)])) as env:
        td = act(env, env.reset_episode(0), RIGHT)
        assert td["out_of_range"].item() and td["terminated"].item()
        assert not td["success"].item()
        assert env.last_step.reward_terms["progress"] == pytest.approx(-1.8, abs=1e-5)
        assert td["reward"].item() == pytest.approx(-1.0 - 2.0, abs=1e-5)


def test_what_is_not_seen_is_not_at_its_goal(env):
    td = env.reset_episode(0)
    td = act(env, td, RIGHT)
    # A hand takes the second square, which was at its goal, while the first one gets there.
    env.world.points[1] = np.nan
    td = act(env, td, RIGHT)
    assert td["matched"].tolist() == [True, False, False, False]
    assert not td["success"].item() and not td["terminated"].item()
    assert env.last_step.reward_terms["progress"] == pytest.approx(1.8, abs=1e-5)
    assert env.last_step.reward_terms["vanished"] == -0.5
    np.testing.assert_allclose(env.last_step.distances, [0.0, np.nan, np.nan, np.nan], atol=1e-6)
    # Nothing of the square that is gone can be pushed.
    assert not env.push_space.by_direction(td["action_mask"])[1].any()
    # Back at its goal it counts again, and its return is no progress.
    env.world.points[1] = GOAL[1]
    td = act(env, td, env.push_space.encode(3, UP))
    assert env.last_step.push.result.status == "unreachable"
    assert td["success"].item()
    assert env.last_step.reward_terms["progress"] == pytest.approx(0.0, abs=1e-5)


def test_an_episode_of_the_rule_based_agent(env, config, tmp_path):
    agent = build_agent(config, np.random.default_rng(0))
    recording = tmp_path / "episode.rrd"
    with RECORDERS["rerun"](recording, config.env) as recorder:
        played = play_episode(env, agent, episode=4, seed=7, recorder=recorder)
    # It pushes the first square to the right twice, and leaves the other alone.
    assert (played.episode, played.seed, played.n_objects, played.objects) == (4, 7, 2, "")
    assert (played.success, played.out_of_range, played.truncated) == (True, False, False)
    assert played.pushes == 2
    assert played.return_ == pytest.approx(1.78 + 11.78, abs=1e-4)
    assert played.error_mm == pytest.approx(0.0, abs=1e-3)

    seen = Recording(recording)
    entities = seen.entities()
    assert not any(entity.startswith(("/world/objects", "/world/goal/")) for entity in entities)
    assert {"/sdf/scene/0", "/sdf/goal/1", "/goal/picture"} <= entities
    assert seen.pushes("/world/camera/picture") == [1, 2, 3]
    distances = [cell[0] for _, cell in sorted(seen["/distance/0", "Scalars:scalars"].items())]
    assert distances == pytest.approx([0.12, 0.06, 0.0], abs=1e-6)
    rewards = [cell[0] for _, cell in sorted(seen["/reward/total", "Scalars:scalars"].items())]
    assert rewards == pytest.approx([1.78, 11.78], abs=1e-5)
    np.testing.assert_allclose(
        seen["/world/push", "Arrows3D:vectors"][1], [[0.06, 0.0, 0.0]], atol=1e-6
    )
    assert "2 pushes" in seen["/summary", "TextDocument:text"][None][0]


@pytest.mark.filterwarnings("error")
def test_an_episode_that_ends_with_an_empty_table(env, config):
    """Somebody clears the table after the first push; the distances are unknown then."""

    def agent(td):
        if td["pushes"].item() == 1:
            env.world.points[:] = np.nan
        return td.set("action", env.push_space.encode(0, RIGHT))

    played = play_episode(env, agent, episode=0, seed=0)
    assert (played.pushes, played.success, played.truncated) == (2, False, False)
    assert np.isnan(played.error_mm)
    # The first push as above; the second one costs itself, two objects and the end.
    assert played.return_ == pytest.approx(1.78 + (-0.02 - 2 * 0.5 - 1.0), abs=1e-4)
    assert env.last_step.reward_terms["none_left"] == -1.0


def test_the_step_limit_ends_an_episode_that_gets_nowhere(config):
    # 20 pushes of two squares to and fro.
    with closing(build(config, START, [(0.0, -0.12), (0.1, 0.1)])) as env:
        td = env.reset_episode(0)
        for push in range(20):
            assert not td["done"].item()
            td = act(env, td, RIGHT if push % 2 == 0 else LEFT)
        assert td["truncated"].item() and not td["terminated"].item()
        assert td["pushes"].item() == 20


def test_what_a_real_table_cannot_do_is_said(env):
    env.reset_episode(0)
    with pytest.raises(SdfgcnError, match="cannot go back"):
        env.save_state()


def test_closing_the_environment_closes_the_world(config):
    env = build(config, START, GOAL)
    env.close()
    assert env.world.closed


def test_no_mujoco_is_needed() -> None:
    script = Path(__file__).with_name("square_world.py")
    path = os.pathsep.join([str(script.parents[1]), os.environ.get("PYTHONPATH", "")])
    played = subprocess.run(
        [sys.executable, script],
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert played.returncode == 0, played.stderr
    assert played.stdout.split() == ["True", "2", "False"]  # success after two pushes
