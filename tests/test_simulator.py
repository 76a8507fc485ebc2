"""The planner whose model is the simulator: it tries pushes, and leaves no trace of them."""

from collections.abc import Iterator

import numpy as np
import pytest
from configs import real_config
from square_world import SquareWorld
from tensordict import TensorDict
from toys import BOX, CAN, FAR, act, assert_equal, lay_out, toy_env

from sdfgcn.agents import build_agent
from sdfgcn.config import Config
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError

D = 8


@pytest.fixture(scope="module")
def config() -> Config:
    return real_config("model=simulator", "robot=gripper", "eval=greedy", "n_objects=2")


@pytest.fixture(scope="module")
def env(config: Config) -> Iterator[RearrangementEnv]:
    env = toy_env(config.env)
    yield env
    env.close()


def test_a_push_that_is_tried_is_the_one_that_is_made(env: RearrangementEnv) -> None:
    layout = [BOX, CAN], [(-0.10, 0.05), (0.0, 0.05)]
    action = 0  # the box along x, into the can
    made = act(env, lay_out(env, *layout), action)
    poses = env.world.poses()
    td = lay_out(env, *layout)
    for _ in range(2):
        assert np.array_equal(env.foresee(action), poses)
    assert np.array_equal(env.foresee(D + 2), env.foresee(D + 2))
    again = act(env, td, action)
    assert np.array_equal(env.world.poses(), poses)
    assert_equal(made, again)
    assert (poses[:, 0] > [-0.09, 0.005]).all()  # it reached both


def test_it_pushes_to_the_goal_and_not_out_of_range(config: Config, env: RearrangementEnv) -> None:
    """A push short of its goal along x; then one whose goal lies beyond the border."""
    agent = build_agent(config, np.random.default_rng(0))
    agent.attach(env)
    td = lay_out(env, [BOX, CAN], [(-0.10, 0.05), FAR], goal=[(0.10, 0.05), FAR])
    assert int(agent(td)["action"]) == 0
    right = config.env.arena.range_x[1]
    td = lay_out(env, [BOX, CAN], [(right - 0.02, 0.05), FAR], goal=[(right + 0.10, 0.05), FAR])
    row, direction = divmod(int(agent(td)["action"]), D)
    assert row == 0
    assert direction != 0


def test_what_cannot_work_is_refused(config: Config) -> None:
    with pytest.raises(SdfgcnError, match=r"model\.planner\.depth is 2, but model=simulator"):
        real_config("model=simulator", "model.planner.depth=2")
    agent = build_agent(config, np.random.default_rng(0))
    with pytest.raises(SdfgcnError, match=r"tries pushes in the world of an env, but has none"):
        agent(TensorDict({"action_mask": np.ones(D, dtype=bool), "pushes": [0]}))
    world = SquareWorld(config.env, [(0.0, 0.0)], [(0.1, 0.0)])
    env = RearrangementEnv(config.env, world=world)
    with pytest.raises(SdfgcnError, match=r"which cannot take back a push"):
        env.foresee(0)
