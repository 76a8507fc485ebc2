"""The weights that come with the package still do what their cards say.

Each policy plays the first scenes of evaluation seed 0 with 3 generated objects, without random
pushes. `shipped_weights.json` holds what it did when its card was written: success and pushes of
each scene.

1. If every scene ends as stored, the policy and its world are unchanged, and the test is over.
2. Otherwise, another processor may have rounded another way: two pushes that are almost equally
   good swap, and the rest of the episode is another one, though no worse on average. So the test
   goes on with further scenes as a sequential probability ratio test (Wald 1945). It weighs the
   lower end of the card's 95% interval against a success rate of one half, each success and
   failure by the logarithm of its likelihood ratio, and ends as soon as the sum leaves
   (-6.9, 6.9), where log(1000) is 6.9. A policy as good as its card fails here once in 1,000 such
   runs, and one that succeeds in half of its scenes or fewer passes once in 1,000. About 15
   successes in a row pass, and four failures fail.

Success rates of the card are those of scanned objects. On the generated ones, which need no
download, 40 scenes gave 100% [91, 100] (push_model) and 98% [87, 100] (sdfgcn).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest
from configs import real_config
from conftest import Envs
from tensordict import TensorDictBase

from sdfgcn.agents import build_agent
from sdfgcn.agents.policy import RELEASED
from sdfgcn.evaluation.play import episode_seeds, play_episode

STORED = json.loads((Path(__file__).parent / "shipped_weights.json").read_text())
BAD = 0.5  # the success rate of weights that are no longer those of the card
ERROR = 0.001  # chance of either wrong verdict
SCENES_MOST = 60  # such a test of these rates ends sooner, with a chance of more than 0.999


def holds(successes: Iterable[bool], good: float) -> bool:
    """Whether the success rate is `good` rather than `BAD`, see above."""
    weight, bound = 0.0, math.log((1 - ERROR) / ERROR)
    for success in successes:
        weight += math.log(BAD / good) if success else math.log((1 - BAD) / (1 - good))
        if abs(weight) >= bound:
            break
    return weight < 0.0


def played(name: str, env_of: Envs) -> Iterator[tuple[bool, int]]:
    """Success and pushes of one scene after another."""
    overrides = STORED[name]["overrides"]
    config = real_config("objects=household", *overrides)
    world = [each for each in overrides if each.partition("=")[0] in ("env", "robot")]
    env = env_of(*world)
    env.n_objects = config.env.n_objects
    for episode in range(SCENES_MOST):
        seed, rng = episode_seeds(0, episode)
        result = play_episode(env, build_agent(config, rng), episode, seed)
        yield result.success, result.pushes


def stays_true(name: str, scenes: Iterator[tuple[bool, int]]) -> bool:
    """The whole test of one policy."""
    stored = [tuple(scene) for scene in STORED[name]["scenes"]]
    first = [next(scenes) for _ in stored]
    if first == stored:
        return True
    outcomes = (success for part in (first, scenes) for success, _ in part)
    return holds(outcomes, STORED[name]["success_least"])


def test_every_released_policy_is_stored() -> None:
    assert set(STORED) == {path.parent.name for path in RELEASED.glob("*/policy.json")}


@pytest.mark.parametrize("name", STORED)
def test_the_interval_is_that_of_the_card(name: str) -> None:
    stored = STORED[name]
    assert stored["card"] in (RELEASED / name / "README.md").read_text()
    low = float(stored["card"].partition("[")[2].partition(",")[0])
    assert stored["success_least"] == pytest.approx(low / 100)


@pytest.mark.parametrize("name", STORED)
def test_a_policy_is_as_good_as_its_card(name: str, env_of: Envs) -> None:
    assert stays_true(name, played(name, env_of))


def test_verdicts_by_hand() -> None:
    """At 0.94, a success weighs log(0.5 / 0.94) = -0.63 and a failure log(0.5 / 0.06) = 2.12."""
    assert holds([True] * 11, 0.94)  # -6.94
    assert not holds([False] * 4, 0.94)  # 8.48
    assert not holds([True, False, False, False, True, False, True], 0.94)  # 7.2 at the sixth
    assert holds([False] + [True] * 15, 0.94)  # -7.3 at the end
    fair = np.random.default_rng(0).random((200, SCENES_MOST))
    assert sum(holds(row < 0.94, 0.94) for row in fair) == 200
    assert sum(holds(row < 0.5, 0.94) for row in fair) == 0


def test_one_scene_that_differs_does_not_fail_it(monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [tuple(scene) for scene in STORED["push_model"]["scenes"]]
    assert stays_true("push_model", iter(scenes))
    rounded = [(True, 16), *scenes[1:], *[(True, 10)] * 20]
    assert stays_true("push_model", iter(rounded))
    assert not stays_true("push_model", iter([(False, 99)] * 20))


@pytest.mark.parametrize("name", STORED)
def test_weights_that_were_ruined_fail_it(
    name: str, env_of: Envs, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same network that takes the worst push it sees; one object, so that it is short."""

    def worst(agent: Callable) -> Callable[[TensorDictBase], TensorDictBase]:
        inner = agent._agent
        monkeypatch.setattr(agent, "_agent", lambda td: -inner(td))
        return agent

    overrides = STORED[name]["overrides"]
    config = real_config("objects=household", *overrides)
    env = env_of(*[each for each in overrides if each.partition("=")[0] in ("env", "robot")])
    env.n_objects = 1
    results = []
    for episode in range(4):
        seed, rng = episode_seeds(0, episode)
        results.append(play_episode(env, worst(build_agent(config, rng)), episode, seed).success)
    assert not holds(results, STORED[name]["success_least"])
