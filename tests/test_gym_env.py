"""The env with Gymnasium's interface."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.utils.env_checker import check_env  # noqa: E402

OVERRIDES = ["objects=household", "robot=gripper", "n_objects=2", "env.pushes_per_object=1"]


@pytest.fixture(scope="module")
def env() -> Iterator[gymnasium.Env]:
    made = gymnasium.make(
        "sdfgcn.gym_env:sdfgcn/Rearrangement-v0", overrides=OVERRIDES, render_mode="rgb_array"
    )
    yield made
    made.close()


# What the checker thinks is wrong but not forbidden is an error; lengths have no bounds here.
@pytest.mark.filterwarnings("error", "ignore:.*A Box observation space")
def test_gymnasium_finds_nothing_wrong(env: gymnasium.Env) -> None:
    check_env(env.unwrapped, skip_render_check=True)


def test_an_episode_of_legal_pushes(env: gymnasium.Env) -> None:
    observation, info = env.reset(seed=4)
    assert observation["scene"]["sdf"].shape == (8, 96, 96)
    assert observation["scene"]["node_mask"].tolist() == [1, 1] + [0] * 6
    ends = []
    for _ in range(2):  # the limit: one push for each of two objects
        action = env.action_space.sample(mask=info["action_mask"])
        assert observation["action_mask"][action] == 1
        before = observation
        observation, reward, terminated, truncated, info = env.step(action)
        ends.append((terminated, truncated))
        assert isinstance(reward, float)
    assert ends == [(False, False), (False, True)]
    assert (before["pushes"], observation["pushes"]) == ([1], [2])  # arrays of their own
    assert set(info) == {"success", "out_of_range", "action_mask"}
    assert env.render().shape == (96, 96, 3)
    again, _ = env.reset(seed=4)
    np.testing.assert_array_equal(again["goal"]["sdf"], observation["goal"]["sdf"])
