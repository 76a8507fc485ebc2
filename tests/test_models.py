"""The Q-networks: shapes and gradients, what must not matter to them, and what must."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from configs import compose_config, real_config
from observations import random_observation
from omegaconf import MISSING
from omegaconf.errors import ConfigKeyError
from tensordict import TensorDict
from torch import Tensor, nn
from torch.nn.functional import pad
from torchrl.data import Categorical
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss

from sdfgcn.cli import to_sentence
from sdfgcn.config import QNetworkConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.models import build_q_network, q_networks
from sdfgcn.models.graph import OccupiedNodes
from sdfgcn.models.layers import PROPAGATIONS, Propagation
from sdfgcn.models.q_network import QNetwork
from sdfgcn.models.sdfgcn import ConvGcnConfig
from sdfgcn.registry import MODELS
from sdfgcn.task.scene import Scene
from sdfgcn.validation import typed

SIZE = 24  # pixels: small, for speed
D = 8  # push directions
NAMES = sorted(q_networks())
GRAPHS = [name for name in NAMES if not q_networks()[name].fixed_rows]
# With each propagation, where a network has the choice.
VARIANTS = [
    (name, changes)
    for name in GRAPHS
    for changes in (
        [{"propagation": each} for each in PROPAGATIONS]
        if hasattr(MODELS.config_type(name), "propagation")
        else [{}]
    )
]
RELATIONAL = {"propagation": "relational"}


def model_config(name: str, **changes: Any) -> QNetworkConfig:
    """The real one; what follows on a change is checked where the network is built."""
    config = replace(real_config(f"model={name}").model, **changes)
    assert isinstance(config, QNetworkConfig)
    return config


def network(name: str, n: int = 4, seed: int = 0, **changes: Any) -> QNetwork:
    return build_q_network(model_config(name, **changes), D, n, SIZE, seed)


def rows_changed(td: TensorDict, change: Callable[[Tensor], Tensor]) -> TensorDict:
    """The observation [B] with every [B, N, ...] of it changed."""
    return td.apply(change, batch_size=td.batch_size)


def padded(td: TensorDict, n: int) -> TensorDict:
    """The observation [B] with empty rows up to n."""
    return rows_changed(
        td, lambda rows: pad(rows, (0, 0) * (rows.dim() - 2) + (0, n - rows.shape[1]))
    )


def q_values(net: QNetwork, td: TensorDict) -> Tensor:
    """[*B, N, D]."""
    return net(td.clone())["action_value"].unflatten(-1, (-1, net.n_directions))


@pytest.fixture(params=NAMES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


# ------------------------------------------------------------------ as a module


@pytest.mark.parametrize("batch", [(), (1,), (5,), (2, 3), (0,)])
def test_shapes(name: str, batch: tuple[int, ...]) -> None:
    td = random_observation(0, 4, batch)
    before = td.clone()
    net = network(name)
    values = net(td)["action_value"]
    assert values.shape == (*batch, 4 * D)
    assert values.dtype == torch.float32
    empty = ~td["scene"].node_mask.repeat_interleave(D, dim=-1)
    assert values[empty].abs().sum() == 0
    # A planner's value of a push that changes nothing is 0.
    assert (values[~empty] != 0).all() or name == "push_model"
    assert set(td.keys()) == {*before.keys(), *net.out_keys}
    assert (td.select(*before.keys()) == before).all()


def test_reads_its_keys_and_no_other(name: str) -> None:
    td, net = random_observation(1, 4, (3,)), network(name)
    assert torch.equal(q_values(net, td.select(*net.in_keys)), q_values(net, td))
    for key in net.in_keys:
        with pytest.raises(KeyError):
            net(td.exclude(key))


def test_reads_plain_tensordicts_too(name: str) -> None:
    """Not every operation of TorchRL keeps the type of a nested scene."""
    td, net = random_observation(1, 4, (3,)), network(name)
    plain = td.clone()
    for key in ("scene", "goal"):
        plain[key] = td[key].to_tensordict(retain_none=False)
    assert type(plain["scene"]) is TensorDict
    assert torch.equal(q_values(net, plain), q_values(net, td))


@pytest.mark.parametrize("n_directions", [4, 16])
def test_as_many_values_a_row_as_directions(name: str, n_directions: int) -> None:
    config = model_config(name)
    if name == "polar_q":  # its maps keep a quarter of their angles
        config = replace(config, angles=4 * n_directions)
    net = build_q_network(config, n_directions, 4, SIZE, 0)
    td = random_observation(0, 4, (2,))
    values = net(td)["action_value"]
    assert values.shape == (2, 4 * n_directions)
    seen = td["scene"].node_mask
    by_row = values.unflatten(-1, (4, n_directions))
    assert (by_row[seen] != 0).all()
    assert by_row[~seen].abs().sum() == 0


def test_gradients_reach_every_parameter(name: str) -> None:
    net = network(name)
    q_values(net, random_observation(0, 4, (8,))).square().sum().backward()
    still = [key for key, weights in net.named_parameters() if not weights.grad.abs().sum() > 0]
    assert not still


@pytest.mark.parametrize("empty", ["current", "all"])
def test_no_object_at_all(name: str, empty: str) -> None:
    td = random_observation(0, 4, (2,))
    td["scene"].node_mask[:] = False
    if empty == "all":
        td["goal"].node_mask[:] = False
    td["matched"][:] = False
    net = network(name)
    values = q_values(net, td)
    assert values.tolist() == torch.zeros(2, 4, D).tolist()
    values.sum().backward()
    assert all(torch.isfinite(weights.grad).all() for weights in net.parameters())


def test_a_batch_equals_one_by_one(name: str) -> None:
    """Also where every picture has another number of objects."""
    td, net = random_observation(2, 4, (6,)), network(name)
    assert len(set(td["scene"].node_mask.sum(-1).tolist())) > 1
    alone = torch.stack([q_values(net, one) for one in td])
    torch.testing.assert_close(q_values(net, td), alone)


def test_weights_follow_from_the_seed_alone(name: str) -> None:
    state = torch.get_rng_state()
    one, same, other = (network(name, seed=seed).state_dict() for seed in (0, 0, 1))
    assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(one[key], same[key]) for key in one)
    assert any(not torch.equal(one[key], other[key]) for key in one)
    generator = torch.Generator().manual_seed(0)
    drawn = build_q_network(model_config(name), D, 4, SIZE, generator).state_dict()
    assert all(torch.equal(one[key], drawn[key]) for key in one)


def test_bfloat16_and_channels_last(name: str) -> None:
    td, net = random_observation(3, 4, (4,)), network(name)
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
    td = random_observation(4, n, (4,))
    td["action_mask"] = td["scene"].node_mask.repeat_interleave(D, dim=-1)
    td["action"] = td["action_mask"].int().argmax(-1)
    after = random_observation(5, n, (4,))
    after["goal"] = td["goal"]
    after["action_mask"] = after["scene"].node_mask.repeat_interleave(D, dim=-1)
    after["reward"] = torch.randn(4, 1, generator=torch.Generator().manual_seed(0))
    after["terminated"] = torch.arange(4).unsqueeze(-1) % 3 == 0
    after["done"] = after["terminated"].clone()
    td["next"] = after
    net = network(name)
    spec = Categorical(n * D)
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
    assert values[-1] < 0.8 * values[0]
    chosen = actor(td.clone())["action"]
    assert td["action_mask"].gather(-1, chosen.unsqueeze(-1)).all()


# ------------------------------------------------------------------ what must not matter


ORDER = torch.tensor([2, 0, 3, 1])


@pytest.mark.parametrize(("graph_name", "changes"), VARIANTS)
def test_the_order_of_objects_does_not_matter(graph_name: str, changes: dict[str, str]) -> None:
    td, net = random_observation(6, 4, (6,)), network(graph_name, **changes)
    before = q_values(net, td)
    after = q_values(net, rows_changed(td, lambda rows: rows[:, ORDER]))
    torch.testing.assert_close(after, before[:, ORDER], atol=1e-6, rtol=1e-4)
    assert not torch.allclose(after, before, atol=1e-3)


def test_the_order_of_objects_matters_to_sdf_cnn() -> None:
    td, net = random_observation(6, 4, (6,), count=4), network("sdf_cnn")
    before = q_values(net, td)
    after = q_values(net, rows_changed(td, lambda rows: rows[:, ORDER]))
    assert not torch.allclose(after, before[:, ORDER], atol=1e-2)


@pytest.mark.parametrize("graph_name", GRAPHS)
def test_padding_does_not_matter(graph_name: str) -> None:
    """The same weights take any number of rows."""
    td, net = random_observation(7, 4, (6,)), network(graph_name)
    before, after = q_values(net, td), q_values(net, padded(td, 8))
    torch.testing.assert_close(after[:, :4], before)
    assert after[:, 4:].abs().sum() == 0


def test_sdf_cnn_takes_its_own_number_of_rows_only() -> None:
    told = "The observation has 8 rows, but this sdf_cnn was built for 4; set env.max_objects=4"
    with pytest.raises(SdfgcnError, match=told):
        network("sdf_cnn")(padded(random_observation(0, 4, (1,)), 8))


def test_what_empty_rows_hold_does_not_matter(name: str) -> None:
    td, net = random_observation(9, 4, (6,)), network(name)
    expected = q_values(net, td)
    for scene in (td["scene"], td["goal"]):
        for field in (scene.sdf, scene.center, scene.position):
            field[~scene.node_mask] = 7.0
    assert torch.equal(q_values(net, td), expected)
    td["matched"][~td["scene"].node_mask] = True  # a match of an object that is not there
    assert torch.equal(q_values(net, td), expected)


# ------------------------------------------------------------------ what must matter


@pytest.mark.parametrize("part", ["scene", "goal"])
def test_who_depends_on_whom(name: str, part: str) -> None:
    """Which objects' Q-values change with object 0, or with its goal.

    SDFGCN-separate sees matched pairs alone.
    """
    td, net = random_observation(10, 3, (1,), count=3), network(name, n=3)
    td["matched"][:] = True
    before = q_values(net, td)
    for field in (td[part].sdf, td[part].center, td[part].position):
        field[0, 0] *= -1.0
    changed = (q_values(net, td) != before).any(dim=-1)[0].tolist()
    assert changed[0]
    edges = getattr(net.config, "edges", None)
    if edges is not None:
        assert changed[1:] == [edges == "complete"] * 2


@pytest.mark.parametrize(
    ("name", "read"),
    [
        *((each, "sdf") for each in ("sdfgcn", "separate", "segmentation_gcn", "sdf_cnn")),
        *(("pose_gcn", "center"), ("gt_pose_gcn", "position")),
    ],
)
def test_what_a_network_looks_at(name: str, read: str) -> None:
    for field in ("sdf", "center", "position"):
        td, net = random_observation(10, 3, (1,), count=3), network(name, n=3)
        before = q_values(net, td)
        td["scene", field][:] *= -1.0
        assert torch.equal(q_values(net, td), before) == (field != read)


@pytest.mark.parametrize("propagation", PROPAGATIONS)
def test_whose_goal_is_whose(propagation: str) -> None:
    """Exchanged goals change Q-values, but not with the paper's formula as it reads."""
    td = random_observation(11, 3, (4,), count=3)
    net = network("sdfgcn", propagation=propagation, n=3)
    td["matched"][:] = True
    before = q_values(net, td)
    td["goal"] = td["goal"].apply(lambda rows: rows[:, [1, 0, 2]])
    after = q_values(net, td)
    if propagation != "shared":
        assert ((after - before).abs() > 1e-3).any(-1)[:, :2].all()
    else:
        torch.testing.assert_close(after, before, atol=1e-6, rtol=1e-4)


# ------------------------------------------------------------------ by hand


def pair_of_two() -> tuple[Scene, Scene, Tensor]:
    """Two current objects, one goal, which is object 1's: three nodes in a row, 0 - 1 - 2.

    Degrees with self loops are 2, 3, 2.
    """
    td = random_observation(0, 2, (1,))
    td["scene"].node_mask[:] = True
    td["goal"].node_mask[:] = td["matched"][:] = torch.tensor([False, True])
    return td["scene"], td["goal"], td["matched"]


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
    every, current = OccupiedNodes(*pair_of_two(), "complete", 2).hops
    propagation = "shared" if own_weight is None else "split"
    layer = Propagation(lambda bias: nn.Conv2d(1, 1, 1, bias=bias), propagation)
    with torch.no_grad():
        layer.weights.weight.fill_(weight)
        layer.weights.bias.zero_()
        if own_weight is not None:
            layer.own_weights.weight.fill_(own_weight)
    rows = torch.tensor([12.0, 6.0, -18.0]).reshape(3, 1, 1, 1)
    torch.testing.assert_close(layer(rows, every).flatten(), torch.tensor(expected))
    torch.testing.assert_close(layer(rows, current).flatten(), torch.tensor(expected[:2]))


def test_split_with_equal_weights_is_shared() -> None:
    td = random_observation(12, 4, (5,))
    nodes = OccupiedNodes(td["scene"], td["goal"], td["matched"], "complete", 1)
    (hop,) = nodes.hops
    split, shared = (
        Propagation(lambda bias: nn.Conv2d(2, 2, 3, padding=1, bias=bias), propagation)
        for propagation in ("split", "shared")
    )
    split.weights.load_state_dict(shared.weights.state_dict())
    split.own_weights.weight = shared.weights.weight
    n_nodes = sum(map(len, nodes.gather(td["scene"].sdf, td["goal"].sdf)))
    rows = torch.randn(n_nodes, 2, 6, 6, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(split(rows, hop), shared(rows, hop))


@pytest.mark.parametrize(
    "graph_name", [name for name, changes in VARIANTS if changes == RELATIONAL]
)
def test_relational_is_split_with_three_objects(graph_name: str) -> None:
    """If all have their goals; with more objects, or without a goal, it is not."""
    split, relational = (
        network(graph_name, n=6, propagation=propagation) for propagation in ("split", "relational")
    )
    three, six = (random_observation(13, 6, (4,), count=count) for count in (3, 6))
    for td in (three, six):
        td["goal"].node_mask[:] = td["matched"][:] = td["scene"].node_mask
    torch.testing.assert_close(q_values(relational, three), q_values(split, three))
    separate = split.config.edges == "separate"
    assert torch.allclose(q_values(relational, six), q_values(split, six), atol=1e-4) == separate
    three["matched"][:] = False
    assert not torch.allclose(q_values(relational, three), q_values(split, three), atol=1e-3)


@pytest.mark.parametrize(
    ("count", "matched", "expected"),
    [
        # A quarter of itself, tripled, a quarter of its goal, half of the mean of the others.
        (1, True, [3 * 4 / 4 + 40 / 4]),
        (1, False, [3 * 4 / 4]),
        (2, True, [3 * 4 / 4 + 40 / 4 + 8 / 2, 3 * 8 / 4 + 80 / 4 + 4 / 2]),
        (4, True, [3 * each / 4 + 10 * each / 4 + (40 - each) / 3 / 2 for each in (4, 8, 12, 16)]),
        (4, False, [3 * each / 4 + (40 - each) / 3 / 2 for each in (4, 8, 12, 16)]),
    ],
)
def test_relational_by_hand(count: int, matched: bool, expected: list[float]) -> None:
    """Objects of values 4, 8, 12 and 16, goals of ten times as much."""
    td = random_observation(0, 4, (1,), count=4)
    for scene in (td["scene"], td["goal"]):
        scene.node_mask[:] = torch.arange(4) < count
    td["matched"][:] = matched
    scenes = td["scene"], td["goal"], td["matched"]
    nodes = OccupiedNodes(*scenes, "complete", n_layers=1, fixed_shares=True)
    layer = Propagation(lambda bias: nn.Linear(1, 1, bias=bias), "relational")
    with torch.no_grad():
        layer.weights.weight.fill_(1.0)
        layer.weights.bias.zero_()
        layer.own_weights.weight.fill_(3.0)
    values = torch.tensor([[4.0], [8.0], [12.0], [16.0]]).unsqueeze(0)
    rows = torch.cat(nodes.gather(values, 10.0 * values))
    torch.testing.assert_close(layer(rows, nodes.hops[0]).flatten(), torch.tensor(expected))


# ------------------------------------------------------------------ configs


@pytest.mark.parametrize("name", ["sdfgcn", "sdf_cnn"])
def test_width_by_name(name: str) -> None:
    """Pooling twice by 3 leaves 2x2 pixels of 24x24, the strides 2, 2, 2, 2 leave them as well."""
    strided, paper = (network(name, width=width) for width in ("strided", "paper"))
    assert sum(isinstance(layer, nn.MaxPool2d) for layer in paper.modules()) == 2
    assert not any(isinstance(layer, nn.MaxPool2d) for layer in strided.modules())
    for net in (strided, paper):
        assert q_values(net, random_observation(0)).abs().sum() > 0


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
        ({"sdf_unit": 0.0}, r"model\.sdf_unit is 0\.0, but must lie between"),
    ],
)
def test_what_contradicts_itself(changes: dict[str, Any], told: str) -> None:
    with pytest.raises(SdfgcnError, match=told):
        network("sdfgcn", **changes)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"strides": [[1], [1]]}, r"strides is \[\[1\], \[1\]\], but must have"),
        ({"channels": [[0, 1, 1], [1, 1, 1]]}, "must list one or more numbers between 1 and"),
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
        build_q_network(real_config("model=rule_based").model, D, 4, SIZE, 0)


@dataclass
class OneNumberConfig(QNetworkConfig):
    bias: float = MISSING


class OneNumber(QNetwork):
    """One number that its config gives, for every push."""

    def action_values(self, scene: Scene, goal: Scene, matched: Tensor) -> Tensor:
        assert isinstance(self.config, OneNumberConfig)
        return self.config.bias * scene.node_mask[..., None].float().repeat(1, 1, self.n_directions)


def test_a_network_of_one_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """Registered, it is typed, checked and built; the configs of the others stay what they are."""
    before = {name: real_config(f"model={name}") for name in NAMES}
    for table in ("_builders", "_configs"):
        monkeypatch.setattr(MODELS, table, dict(getattr(MODELS, table)))
    MODELS.register("one_number", config=OneNumberConfig)(OneNumber)
    composed = compose_config("model=rule_based").copy()
    composed.model = {"name": "one_number", "bias": 2.5}
    config = typed(composed).model
    assert config == OneNumberConfig(name="one_number", bias=2.5)
    td = random_observation(0, 4, (3,))
    values = build_q_network(config, 16, 4, SIZE, 0)(td)["action_value"]
    assert torch.equal(values, 2.5 * td["scene"].node_mask.repeat_interleave(16, dim=-1))
    assert {name: typed(compose_config(f"model={name}")) for name in NAMES} == before
    composed.model = {"name": "one_number", "bias": 2.5, "more": 1}
    with pytest.raises(ConfigKeyError, match="more"):
        typed(composed)
