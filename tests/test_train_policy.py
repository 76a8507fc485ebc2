"""Trained Q-networks as files, and the agent that acts by them."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from configs import real_config
from sdfgcn.agents.q_agent import QAgent
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

import sdfgcn
from sdfgcn.agents import build_agent
from sdfgcn.agents.policy import load_network, save_policy
from sdfgcn.config import N_DIRECTIONS
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import build_q_network, q_networks

SIZE = 96
N = 3


def observation(pushes: int = 0, center: float = 0.0) -> TensorDict:
    generator = torch.Generator().manual_seed(5)
    nodes = torch.tensor([True, True, False])
    place = torch.rand(N, 2, generator=generator) * nodes[:, None]
    return TensorDict(
        {
            "sdf": torch.randn(N, SIZE, SIZE, generator=generator) * nodes[:, None, None],
            "goal_sdf": torch.randn(N, SIZE, SIZE, generator=generator) * nodes[:, None, None],
            "node_mask": nodes,
            "goal_node_mask": nodes,
            "correspondence": torch.tensor([0, 1, -1]),
            "center": place + center * nodes[:, None],
            "goal_center": place,
            "position": place,
            "goal_position": place,
            "action_mask": nodes.repeat_interleave(N_DIRECTIONS),
            "pushes": torch.tensor([pushes]),
        }
    )


def policy(folder: Path, model: str = "gt_pose_gcn", slots: int = N) -> torch.nn.Module:
    """Write an untrained network as a policy."""
    config = real_config(f"model={model}").model
    network = build_q_network(config, N_DIRECTIONS, slots, SIZE, 7)
    save_policy(folder, network, config, slots, SIZE, {"budget": {"pushes": 0}})
    return network


# ------------------------------------------------------------------ files


@pytest.mark.parametrize("model", sorted(q_networks()))
def test_a_policy_comes_back_as_it_was(model: str, tmp_path: Path) -> None:
    network = policy(tmp_path, model)
    loaded, about = load_network(tmp_path)
    assert about["model"]["name"] == model
    given, there = (each(observation())["action_value"] for each in (loaded, network))
    assert torch.equal(given, there)
    assert given.shape == (N * N_DIRECTIONS,)


def test_a_run_folder_is_a_checkpoint(tmp_path: Path) -> None:
    policy(tmp_path / "policy")
    agent = sdfgcn.load_policy(tmp_path)
    assert int(agent(observation())["action"]) in range(2 * N_DIRECTIONS)


def test_loading_a_policy_needs_no_hydra(tmp_path: Path) -> None:
    policy(tmp_path)
    done = subprocess.run(
        [
            *(sys.executable, "-c"),
            f"import sys; sys.modules['hydra'] = None; from sdfgcn import load_policy; "
            f"print(type(load_policy({str(tmp_path)!r})).__name__)",
        ],
        capture_output=True,
        text=True,
    )
    assert done.stdout == "QAgent\n", done.stderr


def test_the_agent_of_a_config(tmp_path: Path) -> None:
    policy(tmp_path)
    config = real_config("model=gt_pose_gcn", f"checkpoint={tmp_path}", "eval.epsilon=0")
    network, _ = load_network(tmp_path)
    best = network(observation())["action_value"][: 2 * N_DIRECTIONS].argmax()
    assert build_agent(config, np.random.default_rng(0))(observation())["action"] == best


@pytest.mark.parametrize("file", ["weights.safetensors", "policy.json"])
def test_a_damaged_policy_is_named(file: str, tmp_path: Path) -> None:
    policy(tmp_path)
    content = (tmp_path / file).read_bytes()
    (tmp_path / file).write_bytes(content[: len(content) // 2])
    with pytest.raises(SdfgcnError, match=f"The policy in {tmp_path} is damaged"):
        load_network(tmp_path)


def test_weights_of_another_network_are_refused(tmp_path: Path) -> None:
    policy(tmp_path / "a", "sdfgcn")
    policy(tmp_path / "b", "gt_pose_gcn")
    (tmp_path / "a" / "weights.safetensors").replace(tmp_path / "b" / "weights.safetensors")
    with pytest.raises(SdfgcnError, match="damaged"):
        load_network(tmp_path / "b")


def test_no_such_policy(tmp_path: Path) -> None:
    with pytest.raises(SdfgcnError, match=r"there is no policy \(policy\.json\) in that folder"):
        load_network(tmp_path / "none")


def test_a_policy_of_another_model(tmp_path: Path) -> None:
    policy(tmp_path)
    config = real_config("model=sdfgcn", f"checkpoint={tmp_path}")
    with pytest.raises(SdfgcnError, match=r"holds weights of model=gt_pose_gcn, but model\.name"):
        build_agent(config, np.random.default_rng(0))


def test_no_weights_at_all() -> None:
    with pytest.raises(SdfgcnError, match="give checkpoint="):
        build_agent(real_config("model=sdfgcn"), np.random.default_rng(0))


def test_policy_json_comes_last(tmp_path: Path) -> None:
    policy(tmp_path)
    about = json.loads((tmp_path / "policy.json").read_text())
    assert about["budget"] == {"pushes": 0}
    assert {path.name for path in tmp_path.iterdir()} == {"policy.json", "weights.safetensors"}


@pytest.mark.parametrize("model", sorted(q_networks()))
def test_actors_in_other_processes_can_have_the_network(model: str) -> None:
    network = build_q_network(real_config(f"model={model}").model, N_DIRECTIONS, N, SIZE, 7)
    copied = pickle.loads(pickle.dumps(network))
    given, there = (each(observation())["action_value"] for each in (copied, network))
    assert torch.equal(given, there)


# ------------------------------------------------------------------ agent


def agent(values: list[float], epsilon: float = 0.0, loop_distance: float | None = 0.005) -> QAgent:
    """An agent that values the actions as given."""
    padded = torch.tensor([*values, *[-9.0] * (N * N_DIRECTIONS - len(values))])
    network = TensorDictModule(lambda mask: padded, ["action_mask"], ["action_value"])
    return QAgent(network, np.random.default_rng(0), epsilon, loop_distance)


def test_takes_the_best_legal_action() -> None:
    td = observation()
    td["action_mask"][1] = False
    given = agent([1.0, 5.0, 3.0])(td)
    assert int(given["action"]) == 2
    assert given["action_value"][:3].tolist() == [1.0, 5.0, 3.0]


def test_a_push_that_led_back_is_not_repeated() -> None:
    greedy = agent([1.0, 5.0, 3.0])
    taken = [int(greedy(observation(i))["action"]) for i in range(3)]
    assert taken == [1, 2, 0]
    assert int(greedy(observation(3, center=0.01))["action"]) == 1  # another state
    assert int(greedy(observation(4, center=0.001))["action"]) == 3  # as good as the first
    assert int(greedy(observation(0))["action"]) == 1  # another episode


def test_all_tried_all_are_allowed_again() -> None:
    td = observation()
    td["action_mask"][2:] = False
    greedy = agent([1.0, 5.0])
    taken = []
    for pushes in range(3):
        td["pushes"] = torch.tensor([pushes])
        taken.append(int(greedy(td.clone())["action"]))
    assert taken == [1, 0, 1]


def test_without_loop_distance_it_repeats_itself() -> None:
    greedy = agent([1.0, 5.0, 3.0], loop_distance=None)
    assert [int(greedy(observation(i))["action"]) for i in range(3)] == [1, 1, 1]


def test_epsilon_is_the_share_of_random_pushes() -> None:
    greedy = agent([1.0, 5.0, 3.0], epsilon=0.5, loop_distance=None)
    taken = [int(greedy(observation(1))["action"]) for _ in range(400)]
    assert sum(action != 1 for action in taken) / 400 == pytest.approx(0.5 * 15 / 16, abs=0.08)
    assert set(taken) <= set(range(2 * N_DIRECTIONS))
