"""The Q-networks: shapes and gradients, what must not matter to them, and what must."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest
import torch
from configs import real_config
from sdfgcn.models.nodes import OccupiedNodes
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn.functional import pad
from torchrl.data import Categorical
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss

from sdfgcn.cli import to_sentence
from sdfgcn.config import N_DIRECTIONS, ModelConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import build_q_network, q_networks
from sdfgcn.models.layers import PROPAGATIONS, Propagation
from sdfgcn.models.q_network import QNetwork
from sdfgcn.models.sdfgcn import ConvGcnConfig

SIZE = 24  # pixels: small, for speed
NAMES = sorted(q_networks())
GRAPHS = [name for name in NAMES if name != "sdf_cnn"]


def model_config(name: str, **changes: Any) -> ModelConfig:
    """The real one; what follows on a change is checked where the network is built."""
    return replace(real_config(f"model={name}").model, **changes)


def network(name: str, n: int = 4, seed: int = 0, **changes: Any) -> QNetwork:
    return build_q_network(model_config(name, **changes), N_DIRECTIONS, n, SIZE, seed)


def observation(seed: int, n: int = 4, batch: Iterable[int] = (), count: int | None = None):
    """Random fields and positions; the objects sit in random slots, all but one of them matched.

    Args:
        seed: Of everything.
        n: Slots.
        batch: The batch shape.
        count: Objects in each picture; a random number for each, up to n, if None.
    """
    generator = torch.Generator().manual_seed(seed)
    batch = tuple(batch)
    td = TensorDict({}, batch)
    for prefix in ("", "goal_"):
        td[prefix + "sdf"] = torch.randn(*batch, n, SIZE, SIZE, generator=generator) * 20 + 10
        for key in ("center", "position"):
            td[prefix + key] = torch.rand(*batch, n, 2, generator=generator) * 0.5 - 0.25
        rank = torch.rand(*batch, n, generator=generator).argsort(-1).argsort(-1)
        most = torch.randint(1, n + 1, (*batch, 1), generator=generator) if count is None else count
        td[prefix + "node_mask"] = rank < most
    match = torch.rand(*batch, n, generator=generator).argsort(-1)
    partner = td["goal_node_mask"].gather(-1, match)
    td["correspondence"] = torch.where(partner & td["node_mask"], match, -1)
    return td


def padded(td: TensorDict, n: int) -> TensorDict:
    """The observation [B] with empty slots up to n."""
    extra = n - td["node_mask"].shape[-1]
    result = TensorDict({}, td.batch_size)
    for key, value in td.items():
        fill = -1 if key == "correspondence" else 0
        result[key] = pad(value, (0, 0) * (value.dim() - 2) + (0, extra), value=fill)
    return result


def q_values(net: nn.Module, td: TensorDict) -> Tensor:
    """[*B, N, 8]."""
    return net(td.clone())["action_value"].unflatten(-1, (-1, N_DIRECTIONS))


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(params=GRAPHS)
def graph_name(request: pytest.FixtureRequest) -> str:
    return request.param


# ------------------------------------------------------------------ as a module


@pytest.mark.parametrize("batch", [(), (1,), (5,), (2, 3), (0,)])
def test_shapes(name: str, batch: tuple[int, ...]) -> None:
    td = observation(0, 4, batch)
    before = td.clone()
    net = network(name)
    values = net(td)["action_value"]
    assert values.shape == (*batch, 4 * N_DIRECTIONS)
    assert values.dtype == torch.float32
    empty = ~td["node_mask"].repeat_interleave(N_DIRECTIONS, dim=-1)
    assert values[empty].abs().sum() == 0
    assert (values[~empty] != 0).all()
    assert set(td.keys()) == {*before.keys(), *net.out_keys}
    assert all(torch.equal(td[key], before[key]) for key in before.keys())  # noqa: SIM118


def test_reads_its_keys_and_no_other(name: str) -> None:
    td, net = observation(1, 4, (3,)), network(name)
    assert torch.equal(q_values(net, td.select(*net.in_keys)), q_values(net, td))
    for key in net.in_keys:
        with pytest.raises(KeyError):
            net(td.exclude(key))


def test_gradients_reach_every_parameter(name: str) -> None:
    net = network(name)
    q_values(net, observation(0, 4, (8,))).square().sum().backward()
    still = [key for key, weights in net.named_parameters() if not weights.grad.abs().sum() > 0]
    assert not still


@pytest.mark.parametrize("empty", ["current", "all"])
def test_no_object_at_all(name: str, empty: str) -> None:
    td = observation(0, 4, (2,))
    td["node_mask"][:] = False
    if empty == "all":
        td["goal_node_mask"][:] = False
    td["correspondence"][:] = -1
    net = network(name)
    values = q_values(net, td)
    assert values.tolist() == torch.zeros(2, 4, N_DIRECTIONS).tolist()
    values.sum().backward()
    assert all(torch.isfinite(weights.grad).all() for weights in net.parameters())


def test_a_batch_equals_one_by_one(name: str) -> None:
    """Also where every picture has another number of objects."""
    td, net = observation(2, 4, (6,)), network(name)
    assert len(set(td["node_mask"].sum(-1).tolist())) > 1
    alone = torch.stack([q_values(net, one) for one in td])
    torch.testing.assert_close(q_values(net, td), alone)


def test_weights_follow_from_the_seed_alone(name: str) -> None:
    state = torch.get_rng_state()
    one, same, other = (network(name, seed=seed).state_dict() for seed in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(one[key], same[key]) for key in one)
    assert not any(torch.equal(one[key], other[key]) for key in one if key.endswith("weight"))
    generator = torch.Generator().manual_seed(0)
    drawn = build_q_network(model_config(name), N_DIRECTIONS, 4, SIZE, generator).state_dict()
    assert all(torch.equal(one[key], drawn[key]) for key in one)


def test_bfloat16_and_channels_last(name: str) -> None:
    td, net = observation(3, 4, (4,)), network(name)
    exact = q_values(net, td).detach()
    net.to(memory_format=torch.channels_last)
    torch.testing.assert_close(q_values(net, td), exact, atol=1e-4, rtol=1e-4)
    with torch.autocast("cpu", torch.bfloat16):
        rough = q_values(net, td)
    assert rough.dtype == torch.float32
    torch.testing.assert_close(rough, exact, atol=0.05 * float(exact.abs().max()), rtol=0.05)


@pytest.mark.parametrize("double", [True, False])
def test_learns_under_dqn_loss(name: str, double: bool) -> None:
    """Double, delayed, with a mask on the next action: the loss falls on a batch of its own."""
    n = 4
    td = observation(4, n, (4,))
    td["action_mask"] = td["node_mask"].repeat_interleave(N_DIRECTIONS, dim=-1)
    td["action"] = td["action_mask"].int().argmax(-1)
    after = observation(5, n, (4,))
    after["action_mask"] = after["node_mask"].repeat_interleave(N_DIRECTIONS, dim=-1)
    after["reward"] = torch.randn(4, 1, generator=torch.Generator().manual_seed(0))
    after["terminated"] = torch.arange(4).unsqueeze(-1) % 3 == 0
    after["done"] = after["terminated"].clone()
    td["next"] = after
    net = network(name)
    spec = Categorical(n * N_DIRECTIONS)
    actor = QValueActor(net, spec=spec, action_mask_key="action_mask")
    loss = DQNLoss(actor, action_space=spec, double_dqn=double, delay_value=True)
    loss.make_value_estimator(gamma=0.5)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    values = []
    for _ in range(10):
        optimiser.zero_grad()
        value = loss(td)["loss"]
        value.backward()
        optimiser.step()
        values.append(value.item())
    assert values[-1] < 0.5 * values[0]
    chosen = actor(td.clone())["action"]
    assert td["action_mask"].gather(-1, chosen.unsqueeze(-1)).all()


# ------------------------------------------------------------------ what must not matter


def mixed(td: TensorDict, order: Tensor, goal_order: Tensor) -> TensorDict:
    """The observation [B] with its slots, and its goal's, in another order."""
    result = td.clone()
    for key, value in td.items():
        result[key] = value[:, goal_order if key.startswith("goal_") else order]
    new_slot = torch.cat([goal_order.argsort(), torch.tensor([-1])])  # [-1] stays -1
    result["correspondence"] = new_slot[td["correspondence"][:, order]]
    return result


ORDERS = (torch.tensor([2, 0, 3, 1]), torch.tensor([1, 3, 2, 0]))


@pytest.mark.parametrize("propagation", PROPAGATIONS)
def test_the_order_of_objects_does_not_matter(graph_name: str, propagation: str) -> None:
    td, net = observation(6, 4, (6,)), network(graph_name, propagation=propagation)
    before, after = q_values(net, td), q_values(net, mixed(td, *ORDERS))
    torch.testing.assert_close(after, before[:, ORDERS[0]], atol=1e-6, rtol=1e-4)
    assert not torch.allclose(after, before, atol=1e-3)


def test_the_order_of_objects_matters_to_sdf_cnn() -> None:
    td, net = observation(6, 4, (6,), count=4), network("sdf_cnn")
    same = torch.arange(4)
    before, after = q_values(net, td), q_values(net, mixed(td, ORDERS[0], same))
    assert not torch.allclose(after, before[:, ORDERS[0]], atol=1e-2)
    # But not the goals': those stand in the order of their matches.
    assert torch.equal(q_values(net, mixed(td, same, ORDERS[1])), before)


def test_padding_does_not_matter(graph_name: str) -> None:
    """The same weights take any number of slots."""
    td, net = observation(7, 4, (6,)), network(graph_name)
    before, after = q_values(net, td), q_values(net, padded(td, 8))
    torch.testing.assert_close(after[:, :4], before)
    assert after[:, 4:].abs().sum() == 0
    three = observation(8, 4, (6,))
    for prefix in ("", "goal_"):
        three[prefix + "node_mask"][:, 3] = False
    three["correspondence"][:, 3] = -1
    three["correspondence"][three["correspondence"] == 3] = -1
    cut = TensorDict({key: value[:, :3] for key, value in three.items()}, three.batch_size)
    torch.testing.assert_close(q_values(net, cut), q_values(net, three)[:, :3])


def test_sdf_cnn_takes_its_own_number_of_slots_only() -> None:
    told = "The observation has 8 rows, but this sdf_cnn was built for 4; set env.max_objects=4"
    with pytest.raises(SdfgcnError, match=told):
        network("sdf_cnn")(padded(observation(0, 4, (1,)), 8))


def test_what_empty_slots_hold_does_not_matter(name: str) -> None:
    td, net = observation(9, 4, (6,)), network(name)
    expected = q_values(net, td)
    for prefix in ("", "goal_"):
        for key in ("sdf", "center", "position"):
            td[prefix + key][~td[prefix + "node_mask"]] = float("nan")
    assert torch.equal(q_values(net, td), expected)
    td["correspondence"][~td["node_mask"]] = 0  # a match of an object that is not there
    assert torch.equal(q_values(net, td), expected)


# ------------------------------------------------------------------ what must matter


FEATURE = {
    **dict.fromkeys(("sdfgcn", "separate", "segmentation_gcn", "sdf_cnn"), "sdf"),
    "pose_gcn": "center",
    "gt_pose_gcn": "position",
}


@pytest.mark.parametrize("goal", [False, True])
def test_who_depends_on_whom(name: str, goal: bool) -> None:
    """Which objects' Q-values change with the features of object 0, or of its goal.

    Objects 0, 1, 2 have the goals 1, 0, 2. SDFGCN-separate sees matched pairs alone.
    """
    td, net = observation(10, 3, (1,), count=3), network(name, n=3)
    td["correspondence"] = torch.tensor([[1, 0, 2]])
    before = q_values(net, td)
    if goal:
        td["goal_" + FEATURE[name]][0, 1] *= -1.0
    else:
        td[FEATURE[name]][0, 0] *= -1.0
    changed = (q_values(net, td) != before).any(dim=-1)[0].tolist()
    assert changed == [True, name != "separate", name != "separate"]


@pytest.mark.parametrize("propagation", PROPAGATIONS)
def test_whose_goal_is_whose(propagation: str) -> None:
    """Exchanged goals change Q-values, but not with the paper's formula as it reads."""
    td = observation(11, 3, (4,), count=3)
    net = network("sdfgcn", propagation=propagation, n=3)
    td["correspondence"][:] = torch.tensor([0, 1, 2])
    before = q_values(net, td)
    td["correspondence"][:] = torch.tensor([1, 0, 2])
    after = q_values(net, td)
    if propagation == "split":
        assert ((after - before).abs() > 1e-3).any(-1)[:, :2].all()
    else:
        torch.testing.assert_close(after, before, atol=1e-6, rtol=1e-4)


# ------------------------------------------------------------------ by hand


def pair_of_two() -> dict[str, Tensor]:
    """Two current objects, one goal, which is object 1's: three nodes in a row, 0 - 1 - 2.

    Degrees with self loops are 2, 3, 2.
    """
    return {
        "node_mask": torch.tensor([[True, True]]),
        "goal_node_mask": torch.tensor([[False, True]]),
        "correspondence": torch.tensor([[-1, 1]]),
    }


@pytest.mark.parametrize(
    ("weight", "own_weight", "expected"),
    [
        # Node 0: 12/2 + 6/sqrt(6); node 1: 12/sqrt(6) + 6/3 - 18/sqrt(6); node 2: 6/sqrt(6) - 18/2,
        # which the activation cuts off.
        (1.0, None, [6 + 6**0.5, 0.0, 0.0]),
        (-1.0, None, [0.0, 6**0.5 - 2, 9 - 6**0.5]),
        # The self loops' part alone is tripled.
        (1.0, 3.0, [18 + 6**0.5, 6 - 6**0.5, 0.0]),
    ],
)
def test_propagation_by_hand(
    weight: float, own_weight: float | None, expected: list[float]
) -> None:
    nodes = OccupiedNodes(pair_of_two(), "complete")
    assert nodes.is_goal.tolist() == [False, False, True]
    propagation = "shared" if own_weight is None else "split"
    layer = Propagation(lambda bias: nn.Conv2d(1, 1, 1, bias=bias), propagation)
    with torch.no_grad():
        layer.weights.weight.fill_(weight)
        layer.weights.bias.zero_()
        if own_weight is not None:
            layer.own_weights.weight.fill_(own_weight)
    rows = torch.tensor([12.0, 6.0, -18.0]).reshape(3, 1, 1, 1)
    torch.testing.assert_close(layer(rows, nodes).flatten(), torch.tensor(expected))
    current = layer(rows, nodes, current_only=True)
    torch.testing.assert_close(current.flatten(), torch.tensor(expected[:2]))


def test_split_with_equal_weights_is_shared() -> None:
    nodes = OccupiedNodes(observation(12, 4, (5,)), "complete")
    split, shared = (
        Propagation(lambda bias: nn.Conv2d(2, 2, 3, padding=1, bias=bias), propagation)
        for propagation in PROPAGATIONS
    )
    split.weights.load_state_dict(shared.weights.state_dict())
    split.own_weights.weight = shared.weights.weight
    rows = torch.randn(len(nodes.is_goal), 2, 6, 6, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(split(rows, nodes), shared(rows, nodes))


# ------------------------------------------------------------------ configs


@pytest.mark.parametrize("name", ["sdfgcn", "sdf_cnn"])
def test_width_by_name(name: str) -> None:
    """Pooling twice by 3 leaves 2x2 pixels of 24x24, the strides 2, 2, 2, 2 leave them as well."""
    strided, paper = (network(name, width=width) for width in ("strided", "paper"))
    assert sum(isinstance(layer, nn.MaxPool2d) for layer in paper.modules()) == 2
    assert not any(isinstance(layer, nn.MaxPool2d) for layer in strided.modules())
    for net in (strided, paper):
        assert q_values(net, observation(0)).abs().sum() > 0


def test_the_ablations_are_named() -> None:
    configs = {name: model_config(name) for name in NAMES}
    assert isinstance(configs["separate"], ConvGcnConfig)
    assert configs["separate"].edges == "separate"
    assert configs["segmentation_gcn"].features == "mask"
    assert configs["pose_gcn"].features == "center"
    assert configs["gt_pose_gcn"].features == "position"


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"width": "wide"}, r"model\.width is 'wide', but must be one of fine, paper, strided"),
        ({"edges": "some"}, r"model\.edges is 'some'"),
        ({"features": "colour"}, r"model\.features is 'colour'"),
        ({"propagation": "none"}, r"model\.propagation is 'none'"),
        ({"sdf_unit": 0.0}, r"model\.sdf_unit is 0\.0, but must be above 0"),
    ],
)
def test_what_contradicts_itself(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(SdfgcnError, match=told):
        network("sdfgcn", **changes)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"strides": [[1], [1]]}, r"strides is \[\[1\], \[1\]\], but must have"),
        ({"channels": [[0, 1, 1], [1, 1, 1]]}, "every number must be at least 1"),
        ({"pooling": [1]}, r"pooling is \[\[1\]\], but must have"),
        ({"pooling": [9, 9]}, "leave nothing of a picture of env.arena.image_size 24"),
        ({"hidden": 0}, r"model\.widths\.strided\.hidden is 0"),
    ],
)
def test_widths_that_do_not_fit(changes: dict[str, Any], told: str) -> None:
    widths = {"strided": replace(model_config("sdfgcn").widths["strided"], **changes)}
    with pytest.raises(SdfgcnError, match=told):
        network("sdfgcn", widths=widths)


def test_a_config_is_typed_by_its_model() -> None:
    """Unknown keys and wrong types are refused, also where the YAML extends another."""
    paper = real_config("model=separate", "model.width=paper").model
    assert isinstance(paper, ConvGcnConfig)
    assert (paper.width, paper.edges) == ("paper", "separate")
    for override, told in (
        ("+model.more=1", "There is no key 'model.more'"),
        ("model.sdf_unit=far", "model.sdf_unit: Value 'far' of type 'str'"),
        ("model.width=wide", "model.width is 'wide'"),
    ):
        with pytest.raises(Exception) as raised:
            real_config("model=separate", override)
        assert told in (to_sentence(raised.value) or "")


def test_a_network_that_there_is_not() -> None:
    with pytest.raises(SdfgcnError, match=r"model\.name is 'rule_based', but must be one of"):
        build_q_network(model_config("rule_based"), N_DIRECTIONS, 4, SIZE, 0)
