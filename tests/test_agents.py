import numpy as np
import pytest
import torch
from configs import real_config
from tensordict import TensorDict

from sdfgcn.agents import build_agent
from sdfgcn.agents.rule_based import RuleBasedAgent, nearest_directions
from sdfgcn.config import N_DIRECTIONS, Config
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import q_networks
from sdfgcn.registry import MODELS

FAR = 0.2  # m, well beyond the success threshold


@pytest.fixture(scope="module", params=sorted(MODELS.keys() - q_networks().keys()))
def each_model(request: pytest.FixtureRequest) -> Config:
    return real_config(f"model={request.param}")


@pytest.fixture(scope="module")
def config() -> Config:
    return real_config("model=rule_based")


def observation(
    offsets: list[tuple[float, float]], forbidden: tuple[int, ...] = (), n: int = 8
) -> TensorDict:
    """Objects at the origin with goals at the offsets, padded to n."""
    goal = torch.zeros(n, 2)
    goal[: len(offsets)] = torch.tensor(offsets)
    nodes = torch.arange(n) < len(offsets)
    legal = nodes.repeat_interleave(N_DIRECTIONS)
    legal[list(forbidden)] = False
    return TensorDict(
        {
            "position": torch.zeros(n, 2),
            "goal_position": goal,
            "correspondence": torch.where(nodes, torch.arange(n), -1),
            "node_mask": nodes,
            "action_mask": legal,
            "sdf": torch.ones(n, 96, 96),
            "goal_sdf": torch.ones(n, 96, 96),
            "goal_node_mask": nodes,
            "center": torch.zeros(n, 2),
            "goal_center": goal,
            "pushes": torch.zeros(1, dtype=torch.int64),
        }
    )


def rule_based(config: Config, seed: int = 0) -> RuleBasedAgent:
    return RuleBasedAgent(config, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("offset", "ranked"),
    [
        ((1.0, 0.0), 0),
        ((0.0, 1.0), 2),
        ((-1.0, 0.0), 4),
        ((-1.0, -1e-9), 4),
        ((-1.0, -1.0), 5),
        ((0.0, -1.0), 6),
        ((1.0, -0.1), 0),
        ((1.0, 0.41), 0),  # 22.3 degrees
        ((1.0, 0.42), 1),  # 22.8 degrees
    ],
)
def test_nearest_direction(offset: tuple[float, float], ranked: int) -> None:
    assert nearest_directions(np.array(offset))[0] == ranked


def test_directions_are_ranked_by_angle() -> None:
    # At 10 degrees: 0 (10 away), 45 (35), 315 (55), 90 (80), 270 (100), 135, 225, 180.
    angle = np.radians(10)
    ranked = nearest_directions(np.array([np.cos(angle), np.sin(angle)]))
    assert ranked.tolist() == [0, 1, 7, 2, 6, 3, 5, 4]


def test_pushes_the_object_that_is_not_at_its_goal(config: Config) -> None:
    near = config.env.success_threshold - 0.001
    td = rule_based(config)(observation([(near, 0), (0, FAR), (0, near)]))
    assert td["action"].dtype == torch.int64
    assert td["action"].shape == ()
    assert td["action"].item() == 1 * N_DIRECTIONS + 2


def test_draws_evenly_among_objects_not_at_their_goals(config: Config) -> None:
    agent = rule_based(config)
    td = observation([(FAR, 0), (0, 0), (-FAR, 0), (0, FAR)])
    drawn = np.bincount([agent(td)["action"].item() // 8 for _ in range(300)], minlength=4)
    assert drawn[1] == 0
    assert drawn[[0, 2, 3]].min() > 70  # of 100 expected; 3.7 standard deviations


def test_takes_the_next_nearest_legal_direction(config: Config) -> None:
    offset = (FAR, 0.01)  # nearest 0, then 1, then 7
    assert rule_based(config)(observation([offset], forbidden=(0,)))["action"].item() == 1
    assert rule_based(config)(observation([offset], forbidden=(0, 1)))["action"].item() == 7


def test_leaves_an_object_that_cannot_be_pushed(config: Config) -> None:
    td = observation([(FAR, 0), (0, FAR)], forbidden=tuple(range(8)))
    assert {rule_based(config, seed)(td)["action"].item() for seed in range(20)} == {8 + 2}


def test_pushes_something_legal_when_nothing_else_helps(config: Config) -> None:
    td = observation([(FAR, 0), (0.0, 0.0)], forbidden=tuple(range(8)))
    assert rule_based(config)(td)["action"].item() // 8 == 1


def test_under_vision_it_goes_by_matched_detections() -> None:
    """True positions say +y for both; the matches and the detected centres say otherwise."""
    td = observation([(0.0, FAR), (0.0, FAR), (0.0, FAR)])
    td["goal_center"] = torch.zeros(8, 2)
    td["goal_center"][0, 0], td["goal_center"][1, 0] = FAR, -FAR
    td["correspondence"] = torch.tensor([1, 0, -1, -1, -1, -1, -1, -1])
    agent = rule_based(real_config("model=rule_based", "perception=vision"))
    actions = {int(agent(td)["action"]) for _ in range(40)}
    # Object 0 belongs to the goal on the left, 1 to that on the right, 2 to none.
    assert actions == {4, N_DIRECTIONS}


def test_refuses_when_nothing_is_legal(config: Config) -> None:
    with pytest.raises(ValueError, match="allows no action"):
        rule_based(config)(observation([(FAR, 0)], forbidden=tuple(range(8))))


def test_action_is_legal_and_follows_from_the_generator(each_model: Config) -> None:
    rng = np.random.default_rng(3)
    for seed in range(20):
        offsets = [tuple(offset) for offset in rng.uniform(-FAR, FAR, (5, 2)).tolist()]
        td = observation(offsets, forbidden=tuple(rng.permutation(40)[:30]))
        first, again = (
            build_agent(each_model, np.random.default_rng(seed))(td.clone())["action"].item()
            for _ in range(2)
        )
        assert td["action_mask"][first]
        assert first == again


def test_unknown_model_is_named(config: Config) -> None:
    with pytest.raises(SdfgcnError, match=r"model\.name is 'guessing'.*rule_based"):
        real_config("model.name=guessing")
