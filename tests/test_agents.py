"""The agents: which push each prefers, and how a push is taken by these preferences."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from configs import real_config
from observations import observation_at
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import Tensor

from sdfgcn.agents import build_agent
from sdfgcn.agents.epsilon_greedy import Agent, EpsilonGreedy, QAgent
from sdfgcn.agents.rule_based import RuleBasedAgent
from sdfgcn.config import Config
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import q_networks
from sdfgcn.registry import MODELS

D = 8  # push directions
FAR = 0.2  # m, well beyond the success threshold


@pytest.fixture(scope="module", params=sorted(MODELS.keys() - q_networks().keys()))
def each_model(request: pytest.FixtureRequest) -> Config:
    """Every agent that needs no checkpoint of its own."""
    return real_config(f"model={request.param}")


@pytest.fixture(scope="module")
def config() -> Config:
    return real_config("model=rule_based")


def observation(offsets: list[tuple[float, float]], forbidden: tuple[int, ...] = ()) -> TensorDict:
    """Objects at the origin with goals at the offsets."""
    td = observation_at([(0.0, 0.0)] * len(offsets), offsets)
    td["action_mask"][list(forbidden)] = False
    return td


def greedy(agent: Agent) -> EpsilonGreedy:
    """Takes what the agent prefers."""
    return EpsilonGreedy(agent, np.random.default_rng(99), epsilon=0.0, loop_distance=None)


def rule_based(config: Config, seed: int = 0) -> EpsilonGreedy:
    return greedy(RuleBasedAgent(config, np.random.default_rng(seed)))


def chosen(agent: EpsilonGreedy, td: TensorDict) -> int:
    return int(agent(td.clone())["action"])


# ------------------------------------------------------------------ the rule


@pytest.mark.parametrize(("offset", "ranked"), [((-1.0, -1.0), 5), ((1.0, 0.42), 1)])
def test_nearest_direction(config: Config, offset: tuple[float, float], ranked: int) -> None:
    assert chosen(rule_based(config), observation([offset])) == ranked


def test_pushes_the_object_that_is_not_at_its_goal(config: Config) -> None:
    near = config.env.success_threshold - 0.001
    td = rule_based(config)(observation([(near, 0), (0, FAR), (0, near)]))
    assert td["action"].dtype == torch.int64
    assert td["action"].shape == ()
    assert td["action"].item() == 1 * D + 2
    assert "action_value" not in td


def test_draws_evenly_among_objects_not_at_their_goals(config: Config) -> None:
    agent = rule_based(config)
    td = observation([(FAR, 0), (0, 0), (-FAR, 0), (0, FAR)])
    drawn = np.bincount([chosen(agent, td) // D for _ in range(300)], minlength=4)
    assert drawn[1] == 0
    assert drawn[[0, 2, 3]].min() > 70  # of 100 expected; 3.7 standard deviations


def test_takes_the_next_nearest_legal_direction(config: Config) -> None:
    offset = (FAR, 0.01)  # nearest 0, then 1, then 7
    assert chosen(rule_based(config), observation([offset], forbidden=(0,))) == 1
    assert chosen(rule_based(config), observation([offset], forbidden=(0, 1))) == 7


def test_leaves_an_object_that_cannot_be_pushed(config: Config) -> None:
    td = observation([(FAR, 0), (0, FAR)], forbidden=tuple(range(D)))
    assert {chosen(rule_based(config, seed), td) for seed in range(20)} == {D + 2}


def test_pushes_something_legal_when_nothing_else_helps(config: Config) -> None:
    td = observation([(FAR, 0), (0.0, 0.0)], forbidden=tuple(range(D)))
    assert chosen(rule_based(config), td) // D == 1


def test_under_vision_it_goes_by_matched_detections() -> None:
    """True positions say +y for all; the detected centres say otherwise."""
    td = observation([(0.0, FAR), (0.0, FAR), (0.0, FAR)])
    td["goal"].center[:3] = torch.tensor([[-FAR, 0.0], [FAR, 0.0], [0.0, -FAR]])
    td["matched"][2] = False
    agent = rule_based(real_config("model=rule_based", "perception=vision"))
    # Object 0 belongs on the left, 1 on the right, and 2 has no known goal.
    assert {chosen(agent, td) for _ in range(40)} == {4, D}


def test_the_whole_ranking_by_hand(config: Config) -> None:
    """The drawn object, the others that are away, then those at their goals, by row."""
    near = config.env.success_threshold / 2
    td = observation([(0.0, near), (FAR, 0.01), (near, 0.0), (0.01, -FAR)])
    preferences = RuleBasedAgent(config, np.random.default_rng(0))(td)
    assert preferences.dtype == torch.float32
    ranked = preferences.argsort(descending=True)[: 4 * D].reshape(4, D)
    rows, directions = ranked[:, 0] // D, ranked % D
    drawn = int(rows[0])
    assert drawn in (1, 3)
    assert rows.tolist() == [drawn, 4 - drawn, 0, 2]
    assert torch.equal(ranked // D, rows[:, None].expand(4, D))
    by_row = dict(zip(rows.tolist(), directions.tolist(), strict=True))
    assert by_row[1] == [0, 1, 7, 2, 6, 3, 5, 4]
    assert by_row[3] == [6, 7, 5, 0, 4, 1, 3, 2]
    assert by_row[0][0] == 2
    assert by_row[2][0] == 0


def test_the_rule_knows_as_many_directions_as_there_are() -> None:
    config = real_config("model=rule_based", "env.push.directions=16")
    td = observation_at([(0.0, 0.0)], [(FAR, 0.4 * FAR)], n_directions=16)  # at 21.8 degrees
    assert chosen(rule_based(config), td) == 1  # which heads at 22.5


# ------------------------------------------------------------------ all agents


def attached(agent: EpsilonGreedy) -> EpsilonGreedy:
    """The agent in an env where pushes move nothing, for one that tries them there."""
    poses = np.zeros((5, 7))
    world = SimpleNamespace(poses=lambda: poses, truth=SimpleNamespace(goal_poses=poses))
    agent.attach(SimpleNamespace(world=world, foresee=lambda action: poses))  # type: ignore[arg-type]
    return agent


def test_action_is_legal_and_follows_from_the_generator(each_model: Config) -> None:
    rng = np.random.default_rng(3)
    for seed in range(20):
        offsets = [tuple(offset) for offset in rng.uniform(-FAR, FAR, (5, 2)).tolist()]
        td = observation(offsets, forbidden=tuple(rng.permutation(40)[:30]))
        first, again = (
            chosen(attached(build_agent(each_model, np.random.default_rng(seed))), td)
            for _ in range(2)
        )
        assert td["action_mask"][first]
        assert first == again


def test_refuses_when_nothing_is_legal(each_model: Config) -> None:
    td = observation([(FAR, 0)], forbidden=tuple(range(D)))
    with pytest.raises(ValueError, match="allows no action"):
        attached(build_agent(each_model, np.random.default_rng(0)))(td)


def test_unknown_model_is_named() -> None:
    with pytest.raises(SdfgcnError, match=r"model\.name is 'guessing'.*rule_based"):
        real_config("model.name=guessing")


def test_the_config_says_how_pushes_are_taken() -> None:
    """With epsilon 1, the rule's preference counts for nothing."""
    td = observation([(FAR, 0)])
    always, never = (real_config("model=rule_based", f"eval.epsilon={each}") for each in (1, 0))
    agent = build_agent(always, np.random.default_rng(0))
    assert {chosen(agent, td) for _ in range(100)} == set(range(D))
    agent = build_agent(never, np.random.default_rng(0))
    assert {chosen(agent, td) for _ in range(100)} == {0}


# ------------------------------------------------------------------ epsilon and the loop-breaker


def at(pushes: int, center: float = 0.0) -> TensorDict:
    """Two objects after so many pushes, both shifted by a distance along x and y, metres."""
    td = observation_at([(0.1 + center, 0.1 + center), (center, center)], [(0.0, FAR)] * 2, n=3)
    td["pushes"][:] = pushes
    return td


def q_agent(values: list[float], **taken: float | None) -> EpsilonGreedy:
    """A Q-network that values the actions as given, and the others less."""
    padded = torch.tensor([*values, *[-9.0] * (3 * D - len(values))])
    network = TensorDictModule(lambda mask: padded, ["action_mask"], ["action_value"])
    options = {"epsilon": 0.0, "loop_distance": 0.005, **taken}
    return EpsilonGreedy(QAgent(network), np.random.default_rng(0), **options)


def test_takes_the_best_legal_action() -> None:
    td = at(0)
    td["action_mask"][1] = False
    given = q_agent([1.0, 5.0, 3.0])(td)
    assert int(given["action"]) == 2
    assert given["action_value"][:3].tolist() == [1.0, 5.0, 3.0]


def test_a_push_that_led_back_is_not_repeated() -> None:
    agent = q_agent([1.0, 5.0, 3.0])
    assert [chosen(agent, at(i)) for i in range(3)] == [1, 2, 0]
    assert chosen(agent, at(3, center=0.01)) == 1  # another state
    assert chosen(agent, at(4, center=0.001)) == 3  # as good as the first
    assert chosen(agent, at(0)) == 1  # another episode


def test_the_rule_does_not_repeat_a_push_that_led_back(config: Config) -> None:
    """The drawn object's next direction, not another object; then the next object's."""
    td = observation([(FAR, 0.01), (0.0, 0.0)])  # object 1 is at its goal
    td["action_mask"][:] = False
    td["action_mask"][[0, 1, D + 4]] = True
    rng = np.random.default_rng(0)
    agent = EpsilonGreedy(RuleBasedAgent(config, rng), rng, epsilon=0.0, loop_distance=0.02)
    taken = []
    for pushes in range(4):
        td["pushes"][:] = pushes
        taken.append(chosen(agent, td))
    assert taken == [0, 1, D + 4, 0]  # all tried: all are allowed again


def test_all_tried_all_are_allowed_again() -> None:
    agent = q_agent([1.0, 5.0])
    taken = []
    for pushes in range(3):
        td = at(pushes)
        td["action_mask"][2:] = False
        taken.append(chosen(agent, td))
    assert taken == [1, 0, 1]


def test_without_loop_distance_it_repeats_itself() -> None:
    agent = q_agent([1.0, 5.0, 3.0], loop_distance=None)
    assert [chosen(agent, at(i)) for i in range(3)] == [1, 1, 1]


def test_epsilon_is_the_share_of_random_pushes() -> None:
    agent = q_agent([1.0, 5.0, 3.0], epsilon=0.5, loop_distance=None)
    taken = [chosen(agent, at(1)) for _ in range(400)]
    assert sum(action != 1 for action in taken) / 400 == pytest.approx(0.5 * 15 / 16, abs=0.08)
    assert set(taken) <= set(range(2 * D))


def test_draws_one_number_a_push_and_none_without_epsilon() -> None:
    class Flat:
        def __call__(self, td: TensorDict) -> Tensor:
            return torch.zeros(3 * D)

    for epsilon, draws in ((0.0, 0), (1e-12, 5)):
        rng, counted = np.random.default_rng(4), np.random.default_rng(4)
        agent = EpsilonGreedy(Flat(), rng, epsilon, loop_distance=None)
        for pushes in range(5):
            agent(at(pushes))
        counted.random(draws)
        assert rng.bit_generator.state == counted.bit_generator.state
