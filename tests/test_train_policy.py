"""Trained Q-networks as files."""

from __future__ import annotations

import hashlib
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
ROOT = Path(__file__).parents[1]
POLICIES = sorted(
    file
    for folder in ("sdfgcn/weights", "experiments/results")
    for file in (ROOT / folder).rglob("policy.json")
)


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


FAULTS = {
    "slots below one": ({"max_objects": -1}, "max_objects is -1, but must be a whole number from"),
    "slots of a billion": ({"max_objects": 10**9}, r"max_objects is 1000000000, but .* to 256"),
    "half a slot": ({"max_objects": 2.5}, r"max_objects is 2\.5"),
    "other slots": (
        {"max_objects": N + 1},
        r"is float32 \[\d+.*, but float32 \[\d+.* in the network",
    ),
    "no directions": ({"directions": 0}, "directions is 0, but must be"),
    "directions in words": ({"directions": "8"}, "directions is '8', but must be"),
    "a huge picture": ({"image_size": 10**6}, "image_size is 1000000, but must be"),
    "an unknown key": ({"code": "import os"}, r"policy\.json has the unknown key 'code'"),
    "another checksum": ({"sha256": "0" * 64}, r"weights\.safetensors does not have the checksum"),
    "no checksum": ({"sha256": None}, "does not have the checksum"),
    "no model": ({"model": None}, "model is None, but must be an object"),
    "no numbers": ({"training": {"curriculum.counts": ["a"]}}, "in training is 'a', but must be"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_senseless_policy_is_named(fault: str, tmp_path: Path) -> None:
    changes, told = FAULTS[fault]
    policy(tmp_path, "sdf_cnn")
    load_network(tmp_path)
    about = json.loads((tmp_path / "policy.json").read_text())
    (tmp_path / "policy.json").write_text(json.dumps(about | changes))
    refused(tmp_path, told)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"hidden": 10**9}, "model.hidden is 1000000000, but no network has more than 4096"),
        ({"hidden": -1}, "damaged"),
        ({"hidden": 4095}, r"but float32 \[.*4095.* in the network"),  # no memory is taken for it
        ({"position_unit": float("nan")}, "model.position_unit is nan, but must be finite"),
        ({"extra": 1}, "ConfigKeyError"),
        ({"name": "nonsense"}, "model.name is 'nonsense', but must be one of"),
    ],
)
def test_a_senseless_network_is_named(changes: dict, told: str, tmp_path: Path) -> None:
    policy(tmp_path)
    about = json.loads((tmp_path / "policy.json").read_text())
    about["model"] |= changes
    (tmp_path / "policy.json").write_text(json.dumps(about))
    refused(tmp_path, told)


def refused(folder: Path, told: str) -> None:
    with pytest.raises(SdfgcnError, match=told) as raised:
        load_network(folder)
    assert str(raised.value).startswith(f"The policy in {folder} is damaged (")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("byte", [0, 8, 200, -1])
def test_a_flipped_bit_in_the_weights_is_noticed(byte: int, tmp_path: Path) -> None:
    policy(tmp_path)
    content = bytearray((tmp_path / "weights.safetensors").read_bytes())
    content[byte] ^= 1
    (tmp_path / "weights.safetensors").write_bytes(content)
    refused(tmp_path, "does not have the checksum")


@pytest.mark.parametrize("value", [torch.nan, torch.inf])
def test_weights_that_are_not_finite_are_refused(value: float, tmp_path: Path) -> None:
    network = build("gt_pose_gcn")
    name, last = list(network.named_parameters())[-1]
    with torch.no_grad():
        last.view(-1)[-1] = value
    save_policy(tmp_path, network, {})
    refused(tmp_path, f"'{name}' is not finite")


def test_a_policy_of_before_there_were_checksums(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """It loads with a warning; what can be checked is checked."""
    policy(tmp_path)
    about = json.loads((tmp_path / "policy.json").read_text())
    del about["sha256"]
    (tmp_path / "policy.json").write_text(json.dumps(about))
    load_network(tmp_path)
    assert f"The policy in {tmp_path} was written without a checksum" in caplog.text


def test_what_a_policy_cannot_say(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"A policy has no \['note'\]"):
        save_policy(tmp_path, build("gt_pose_gcn"), {"note": "x"})


@pytest.mark.parametrize("file", POLICIES, ids=lambda file: file.parent.name)
def test_policies_in_the_repository_have_a_checksum(file: Path) -> None:
    weights = file.with_name("weights.safetensors").read_bytes()
    assert json.loads(file.read_text())["sha256"] == hashlib.sha256(weights).hexdigest()


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
