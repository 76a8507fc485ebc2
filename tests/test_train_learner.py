"""Double DQN: targets worked out by hand, the target network's copies, precision, exploration."""

from __future__ import annotations

import copy

import pytest
import torch
from configs import real_config
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn

from sdfgcn.errors import SdfgcnError
from sdfgcn.task.push_space import PushSpace
from sdfgcn.train.exploration import EpsilonGreedyPolicy
from sdfgcn.train.learner import Learner

CONFIG = real_config("model=sdfgcn")
TRAIN = CONFIG.train
N_DIRECTIONS = CONFIG.env.push.directions
ACTIONS = PushSpace(CONFIG.env.push, CONFIG.env.arena).spec(1)


class Constant(TensorDictModuleBase):
    """Values one object's 8 directions by a parameter, whatever it sees."""

    in_keys = ("node_mask",)
    out_keys = ("action_value",)

    def __init__(self, values: list[float]) -> None:
        super().__init__()
        self.values = nn.Parameter(torch.tensor(values))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = (*tensordict.batch_size, N_DIRECTIONS)
        tensordict["action_value"] = self.values.expand(shape).clone()
        return tensordict


def batch(reward: float, terminated: bool, legal_next: list[int], action: int = 0) -> TensorDict:
    mask = torch.zeros(1, N_DIRECTIONS, dtype=torch.bool)
    mask[0, legal_next] = True
    flag = torch.tensor([[terminated]])
    every = torch.ones(1, N_DIRECTIONS, dtype=torch.bool)
    nodes = torch.ones(1, 1, dtype=torch.bool)
    return TensorDict(
        {
            "node_mask": nodes,
            "action_mask": every,
            "action": torch.tensor([action]),
            "next": {
                "node_mask": nodes,
                "action_mask": mask,
                "reward": torch.tensor([[reward]]),
                "terminated": flag,
                "done": flag,
            },
        },
        batch_size=[1],
    )


def learner(**news: object) -> Learner:
    train = copy.copy(TRAIN)
    for key, value in {"loss": "l2", "learning_rate": 0.1, "target_interval": 2, **news}.items():
        setattr(train, key, value)
    return Learner(Constant([1.0, 2.0, 5.0, *[0.0] * 5]), ACTIONS, train, "cpu")


@pytest.mark.parametrize(
    ("terminated", "legal_next", "target"),
    [
        (False, [0, 1, 2], 3.0 + 0.5 * 5.0),
        (False, [0, 1], 3.0 + 0.5 * 2.0),  # the best is not legal
        (True, [0, 1, 2], 3.0),
    ],
)
def test_the_target(terminated: bool, legal_next: list[int], target: float) -> None:
    figures = learner().update(batch(3.0, terminated, legal_next))
    assert figures["loss"] == pytest.approx((target - 1.0) ** 2)


def test_double_and_delayed() -> None:
    """The network picks the next push, the target network of before values it."""
    held = learner(target_interval=100)
    for _ in range(60):
        held.update(batch(9.0, True, [0]))  # direction 0 comes to be the best: above 5
    assert float(held.network.values[0].detach()) > 5.0
    # Picked by the network: 0; worth 1 to the target network.
    figures = held.update(batch(0.0, False, [0, 1, 2], action=2))
    assert figures["loss"] == pytest.approx((5.0 - 0.5 * 1.0) ** 2, rel=1e-3)


def test_the_target_network_is_copied_every_interval() -> None:
    held = learner(target_interval=3)
    copies = []
    for _ in range(7):
        held.update(batch(9.0, True, [0]))
        there = held._loss.target_value_network_params.flatten_keys()
        (values,) = (value for key, value in there.items() if "values" in key)
        copies.append(float(values.detach()[0]))
    assert copies[:2] == [1.0, 1.0]
    assert copies[2] == copies[3] == copies[4] != 1.0
    assert copies[5] == copies[6] != copies[4]


def test_goes_on_from_its_state() -> None:
    there, here = learner(target_interval=3), learner(target_interval=3)
    for _ in range(4):
        there.update(batch(9.0, True, [0]))
    here.load_state_dict(copy.deepcopy(there.state_dict()))
    for _ in range(4):
        pair = [each.update(batch(9.0, False, [0, 1])) for each in (there, here)]
        assert pair[0] == pair[1]
    assert here.updates == 8


def test_precision_is_tried_on_a_copy() -> None:
    held = learner()
    assert held.choose_precision("auto", batch(1.0, False, [0])) in ("float32", "bfloat16")
    assert held.updates == 0
    assert held.network.values.tolist() == [1.0, 2.0, 5.0, *[0.0] * 5]
    assert held.choose_precision("float32", batch(1.0, False, [0])) == "float32"


def test_epsilon_falls_and_pushes_are_legal() -> None:
    torch.manual_seed(0)
    policy = EpsilonGreedyPolicy(
        Constant([1.0, 2.0, 5.0, *[0.0] * 5]), ACTIONS, TRAIN, epsilon_pushes=100
    )
    assert policy.epsilon == pytest.approx(TRAIN.epsilon_start)
    policy.pushed(50)
    middle = (TRAIN.epsilon_start + TRAIN.epsilon_end) / 2
    assert policy.epsilon == pytest.approx(middle, abs=1e-3)
    policy.pushed(500)
    assert policy.epsilon == pytest.approx(TRAIN.epsilon_end)
    observation = batch(0.0, False, [0]).exclude("next")
    observation["action_mask"][0, [2, 5]] = False
    taken = [int(policy.module(observation.clone())["action"]) for _ in range(300)]
    assert set(taken) == {0, 1, 3, 4, 6, 7}
    assert taken.count(1) / 300 > 0.85


def test_the_average_is_exponential() -> None:
    held = learner(ema_decay=0.75)
    seen = []
    for _ in range(3):
        held.update(batch(3.0, True, [0]))
        seen.append(float(held.network.values[0].detach()))
    assert len(set(seen)) == 3
    wanted = 0.75 * (0.75 * seen[0] + 0.25 * seen[1]) + 0.25 * seen[2]
    assert float(held.averaged.values[0].detach()) == pytest.approx(wanted, abs=1e-6)


def test_the_average_goes_on_from_a_checkpoint() -> None:
    there, here = learner(ema_decay=0.75), learner(ema_decay=0.75)
    there.update(batch(3.0, True, [0]))
    here.load_state_dict(copy.deepcopy(there.state_dict()))
    for held in (there, here):
        held.update(batch(3.0, True, [0]))
    assert torch.equal(there.averaged.values, here.averaged.values)


def test_who_pushes_follows_the_learner() -> None:
    held = learner()
    policy = EpsilonGreedyPolicy(held.network, ACTIONS, TRAIN, epsilon_pushes=100)
    held.update(batch(9.0, True, [0]))
    policy.load_weights(held.network)
    td = policy.module(batch(0.0, False, [0]).exclude("next"))
    assert float(td["action_value"][0, 0]) == float(held.network.values[0].detach()) != 1.0


@pytest.mark.parametrize("reward", [float("nan"), float("inf")])
def test_a_loss_that_is_not_finite_ends_the_training(reward: float) -> None:
    learning = learner()
    learning.update(batch(1.0, True, [0]))
    before = learning.network.values.detach().clone()
    with pytest.raises(
        SdfgcnError, match=r"^In update 2, the loss is (nan|inf) and .* (nan|inf), so"
    ):
        learning.update(batch(reward, True, [0]))
    assert torch.equal(learning.network.values, before)
    assert learning.updates == 1
