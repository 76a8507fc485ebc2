"""Trained Q-networks as files."""

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
from observations import random_observation
from tensordict import TensorDict

import sdfgcn
from sdfgcn.agents import build_agent
from sdfgcn.agents.policy import load_network, save_policy
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import build_q_network, q_networks
from sdfgcn.models.q_network import QNetwork

SIZE = 96
N = 3
D = 8  # push directions


def observation() -> TensorDict:
    """Two objects in three rows; all of both may be pushed."""
    td = random_observation(5, N, count=2, size=SIZE)
    td["action_mask"] = td["scene"].node_mask.repeat_interleave(D)
    td["pushes"] = torch.zeros(1, dtype=torch.int64)
    return td


def build(model: str, n_directions: int = D) -> QNetwork:
    config = real_config(f"model={model}").model
    return build_q_network(config, n_directions, N, SIZE, 7)


def policy(folder: Path, model: str = "gt_pose_gcn", n_directions: int = D) -> QNetwork:
    """Write an untrained network as a policy."""
    network = build(model, n_directions)
    save_policy(folder, network, {"budget": {"pushes": 0}})
    return network


@pytest.mark.parametrize("model", sorted(q_networks()))
def test_a_policy_comes_back_as_it_was(model: str, tmp_path: Path) -> None:
    network = policy(tmp_path, model)
    loaded, about = load_network(tmp_path)
    assert about["model"]["name"] == model
    given, there = (each(observation())["action_value"] for each in (loaded, network))
    assert torch.equal(given, there)
    assert given.shape == (N * D,)


def test_a_policy_knows_its_directions(tmp_path: Path) -> None:
    network = policy(tmp_path, n_directions=16)
    loaded, about = load_network(tmp_path)
    assert about["directions"] == loaded.n_directions == 16
    given, there = (each(observation())["action_value"] for each in (loaded, network))
    assert torch.equal(given, there)
    assert given.shape == (N * 16,)


def test_the_released_policy_loads() -> None:
    network, about = load_network("sdfgcn")
    assert about["directions"] == 8
    assert network(observation())["action_value"].shape == (N * D,)


def test_a_run_folder_is_a_checkpoint(tmp_path: Path) -> None:
    policy(tmp_path / "policy")
    td = sdfgcn.load_policy(tmp_path)(observation())
    assert td["action_mask"][td["action"]]


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
    assert done.stdout == "EpsilonGreedy\n", done.stderr


def test_the_agent_of_a_config(tmp_path: Path) -> None:
    policy(tmp_path)
    config = real_config("model=gt_pose_gcn", f"checkpoint={tmp_path}", "eval.epsilon=0")
    network, _ = load_network(tmp_path)
    values = network(observation())["action_value"]
    td = build_agent(config, np.random.default_rng(0))(observation())
    assert torch.equal(td["action_value"], values)
    assert td["action"] == values.where(td["action_mask"], -torch.inf).argmax()


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


@pytest.mark.parametrize(
    ("override", "told"),
    [
        (
            "env.push.directions=16",
            r"env\.push\.directions is 16, but checkpoint=push_model .* 8;",
        ),
        ("env.arena.image_size=128", r"env\.arena\.image_size is 128, but .* trained with 96;"),
    ],
)
def test_weights_of_another_env_are_refused(override: str, told: str) -> None:
    with pytest.raises(SdfgcnError, match=told):
        build_agent(real_config(override), np.random.default_rng(0))


@pytest.mark.parametrize(
    ("training", "n_objects", "refused"),
    [
        ({"n_objects": 3, "curriculum.counts": []}, 3, False),
        ({"n_objects": 3, "curriculum.counts": []}, 4, True),
        ({"n_objects": 3, "curriculum.counts": [2, 4]}, 4, False),
    ],
)
@pytest.mark.parametrize("model", ["sdf_cnn", "sdfgcn"])
def test_inputs_that_no_training_filled(
    model: str, training: dict, n_objects: int, refused: bool, tmp_path: Path
) -> None:
    """A network with inputs of its own for each row has learned nothing about the others."""
    save_policy(tmp_path, build(model), {"budget": None, "training": training})
    config = real_config(f"model={model}", f"checkpoint={tmp_path}", f"n_objects={n_objects}")
    if refused and model == "sdf_cnn":
        with pytest.raises(SdfgcnError, match=r"n_objects is 4, but .* trained with at most 3"):
            build_agent(config, np.random.default_rng(0))
    else:
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
    network = build(model)
    copied = pickle.loads(pickle.dumps(network))
    given, there = (each(observation())["action_value"] for each in (copied, network))
    assert torch.equal(given, there)
