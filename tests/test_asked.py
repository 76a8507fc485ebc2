"""Values of one action alone: what is left out has no effect on them, nor on an update."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from configs import real_config
from observations import random_observation
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Categorical

from sdfgcn.config import QNetworkConfig
from sdfgcn.models import build_q_network, q_networks
from sdfgcn.models.graph import EDGES, OccupiedNodes
from sdfgcn.models.layers import PROPAGATIONS, conv_block, labelled_block
from sdfgcn.models.q_network import ASKED, QNetwork
from sdfgcn.registry import MODELS
from sdfgcn.train.learner import Learner

SIZE, N, D = 24, 4, 8
TRAIN = real_config("model=sdfgcn").train


def variants() -> list[tuple[str, dict[str, str]]]:
    """Every network, with each propagation and each kind of edges where it has the choice."""
    found: list[tuple[str, dict[str, str]]] = []
    for name in sorted(q_networks()):
        if hasattr(MODELS.config_type(name), "propagation"):
            found += [
                (name, {"propagation": propagation, "edges": edges})
                for propagation in PROPAGATIONS
                for edges in EDGES
            ]
        else:
            found.append((name, {}))
    return found


def network(name: str, **changes: Any) -> QNetwork:
    config = replace(real_config(f"model={name}").model, **changes)
    assert isinstance(config, QNetworkConfig)
    return build_q_network(config, D, N, SIZE, 0)


def gradients(net: QNetwork, loss: Tensor) -> list[Tensor]:
    return list(torch.autograd.grad(loss, list(net.parameters()), materialize_grads=True))


def assert_near(actual: list[Tensor], expected: list[Tensor]) -> None:
    """Equal up to rounding, relative to each tensor's largest entry."""
    for one, other in zip(actual, expected, strict=True):
        largest = float(other.abs().max())
        torch.testing.assert_close(one, other, rtol=1e-5, atol=1e-5 * largest)


@pytest.mark.parametrize("count", [1, 3, 4, None])
@pytest.mark.parametrize(("name", "changes"), variants())
def test_one_value_of_all(name: str, changes: dict[str, str], count: int | None) -> None:
    """With every row in turn, also empty ones; None: graphs of different sizes."""
    net, td = network(name, **changes), random_observation(3, N, (6,), count, size=SIZE)
    if count is None:
        td["scene"].node_mask[0], td["matched"][0] = False, False
    asked = torch.arange(6) % N * D + torch.arange(6)
    values = net(td.clone())["action_value"].gather(-1, asked.unsqueeze(-1))
    alone = net(td.clone().set(ASKED, asked))["action_value"]
    assert alone.shape == (6, N * D)
    assert torch.isfinite(alone).all()
    alone = alone.gather(-1, asked.unsqueeze(-1))
    assert_near([alone], [values])
    assert_near(*(gradients(net, each.square().sum()) for each in (alone, values)))


@pytest.mark.parametrize("batch", [(), (2, 3), (0,)])
@pytest.mark.parametrize("name", sorted(q_networks()))
def test_one_value_of_any_batch(name: str, batch: tuple[int, ...]) -> None:
    net, td = network(name), random_observation(3, N, batch, count=N, size=SIZE)
    asked = torch.full(batch, D + 2)
    values = net(td.clone())["action_value"][..., D + 2]
    alone = net(td.set(ASKED, asked))["action_value"][..., D + 2]
    torch.testing.assert_close(alone, values, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(
    ("edges", "counts"),
    [
        # Two layers: all six nodes, then the asked one with its neighbours, then itself.
        ("complete", [6, 4, 1]),
        ("separate", [2, 2, 1]),
    ],
)
def test_how_many_nodes_one_value_takes(edges: str, counts: list[int]) -> None:
    td = random_observation(0, N, (1,), count=3, size=2)
    td["goal"].node_mask[:] = td["matched"][:] = td["scene"].node_mask
    asked = td["scene"].node_mask & (td["scene"].node_mask.cumsum(-1) == 2)
    scenes = td["scene"], td["goal"], td["matched"]
    nodes = OccupiedNodes(*scenes, edges, n_layers=2, asked=asked)
    rows = torch.cat(nodes.gather(td["scene"].center, td["goal"].center))
    found = [len(rows)]
    for hop in nodes.hops:
        rows = hop.mix(rows, own=True)
        found.append(len(rows))
    assert found == counts


@pytest.mark.parametrize("label", [0.0, 1.0])
@pytest.mark.parametrize("form", [torch.contiguous_format, torch.channels_last])
def test_a_labelled_block_has_two_channels(label: float, form: torch.memory_format) -> None:
    block = conv_block(2, [4, 3], [2, 1], 2).to(memory_format=form)
    pictures = torch.randn(5, 12, 12, generator=torch.Generator().manual_seed(0))
    both = torch.stack([pictures, torch.full_like(pictures, label)], dim=1)
    results = block(both), labelled_block(block, pictures, label)
    weights = list(block.parameters())
    torch.testing.assert_close(*results)
    expected, found = (torch.autograd.grad(each.square().sum(), weights) for each in results)
    assert_near(list(found), list(expected))


# ------------------------------------------------------------------ in an update


def transitions(count: int | None) -> TensorDict:
    """A batch of 6: the first two end, one of them without a legal push."""
    generator = torch.Generator().manual_seed(1)
    td, after = (random_observation(seed, N, (6,), count, size=SIZE) for seed in (4, 5))
    after["goal"] = td["goal"]
    after["scene"].node_mask[1], after["matched"][1] = False, False
    for each in (td, after):
        each["action_mask"] = each["scene"].node_mask.repeat_interleave(D, dim=-1)
        each["matched"] &= each["goal"].node_mask & each["scene"].node_mask
    td["action"] = td["action_mask"].float().multinomial(1, generator=generator).squeeze(-1)
    after["reward"] = torch.randn(6, 1, generator=generator)
    after["terminated"] = torch.arange(6).unsqueeze(-1) <= 1
    after["done"] = torch.arange(6).unsqueeze(-1) <= 2
    return td.set("next", after)


def learners(name: str, **changes: Any) -> list[Learner]:
    """One that computes what it needs, and one that leaves everything to TorchRL's loss.

    Their networks differ from their target networks.
    """
    pair = []
    for all_values in (False, True):
        net = network(name, **changes)
        pair.append(Learner(net, Categorical(N * D), TRAIN, "cpu", all_values))
        generator = torch.Generator().manual_seed(2)
        with torch.no_grad():
            for weights in net.parameters():
                weights += 0.02 * torch.randn(weights.shape, generator=generator)
    return pair


@pytest.mark.parametrize("count", [1, 3, None])
@pytest.mark.parametrize(("name", "changes"), variants())
def test_the_loss_is_torchrl_s(name: str, changes: dict[str, str], count: int | None) -> None:
    td, pair = transitions(count), learners(name, **changes)
    losses = [held._loss_of(td.clone()) for held in pair]
    torch.testing.assert_close(*losses, rtol=1e-5, atol=1e-6)
    found, expected = (
        gradients(held.network, loss) for held, loss in zip(pair, losses, strict=True)
    )
    assert_near(found, expected)
    assert max(float(each.abs().max()) for each in expected) > 0


def test_the_batch_is_left_as_it_is() -> None:
    td, (held, _) = transitions(3), learners("pose_gcn")
    before = td.clone()
    held.update(td)
    assert (td == before).all()


def test_no_legal_push_is_worth_nothing() -> None:
    """Where TorchRL's own double DQN takes the number that stands for an illegal push, -3e38."""
    td, (held, _) = transitions(3), learners("pose_gcn")
    td["next", "terminated"][1] = td["next", "done"][1] = False
    td["next", "reward"][:] = 0.0
    held._loss.reduction = "none"
    taken = held.network(td.clone())["action_value"].gather(-1, td["action"].unsqueeze(-1))
    expected = torch.nn.functional.smooth_l1_loss(taken[1], torch.zeros(1), reduction="none")
    torch.testing.assert_close(held._loss_of(td)[1:2], expected)


def test_checkpoints_are_exchangeable() -> None:
    here, there = learners("pose_gcn")
    there.update(transitions(3))
    here.load_state_dict(there.state_dict())
    assert here.state_dict()["loss"].keys() == there.state_dict()["loss"].keys()
    td = transitions(None)
    torch.testing.assert_close(*(held._loss_of(td.clone()) for held in (here, there)))
