"""The scene graph: cases worked by hand, and what must not matter (padding, order, batches)."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from configs import real_config
from sdfgcn.graph import (
    EDGES,
    NODE_FEATURES,
    SceneGraph,
    adjacency_matrix,
    node_features,
    normalise,
    scene_graph,
    with_goal,
)
from tensordict import TensorDict
from torch import Tensor
from torch.nn.functional import pad
from torchrl.envs import check_env_specs

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.sdf import signed_distance

SIZE = 12

# Two current objects, three in the goal, N = 3: current 0 is goal 1, current 1 is goal 0, and
# goal 2 has no partner. Nodes: 0 and 1, 2 empty, and 3 to 5 the goal's.
TWO_AND_THREE = {
    "complete": [
        [0, 1, 0, 0, 1, 0],
        [1, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 1, 1],
        [1, 0, 0, 1, 0, 1],
        [0, 0, 0, 1, 1, 0],
    ],
    "separate": [
        [0, 0, 0, 0, 1, 0],
        [0, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [1, 0, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0],
    ],
}


def two_and_three() -> tuple[Tensor, Tensor, Tensor]:
    """Node mask, goal node mask, correspondence."""
    return torch.tensor([1, 1, 0]).bool(), torch.ones(3).bool(), torch.tensor([1, 0, -1])


def observation(seed: int, n: int = 4, *batch: int) -> TensorDict:
    """Random squares; nodes are empty and unmatched at random, in no order.

    Rows of empty nodes hold numbers, too: the node masks alone say what counts.
    """
    rng = np.random.default_rng(seed)
    values = {}
    for prefix in ("", "goal_"):
        low = rng.integers(0, SIZE - 4, (*batch, n, 2, 1, 1))
        grid = np.indices((SIZE, SIZE))
        masks = ((grid >= low) & (grid < low + 4)).all(axis=-3)
        flat = [signed_distance(mask) for mask in masks.reshape(-1, SIZE, SIZE)]
        node_mask = rng.random((*batch, n)) < 0.7
        values |= {
            prefix + "sdf": np.stack(flat).reshape(masks.shape),
            prefix + "node_mask": node_mask,
            prefix + "center": rng.normal(size=(*batch, n, 2)).astype(np.float32),
            prefix + "position": rng.normal(size=(*batch, n, 2)).astype(np.float32),
        }
    order = rng.permuted(np.tile(np.arange(n), (*batch, 1)), axis=-1)
    matched = values["node_mask"] & np.take_along_axis(values["goal_node_mask"], order, axis=-1)
    values["correspondence"] = np.where(matched & (rng.random((*batch, n)) < 0.8), order, -1)
    return TensorDict({key: torch.tensor(value) for key, value in values.items()}, batch)


def padded(td: TensorDict, n: int) -> TensorDict:
    """An unbatched observation with empty nodes up to n."""
    extra = n - len(td["node_mask"])
    result = {}
    for key, value in td.items():
        fill = -1 if key == "correspondence" else 0
        result[key] = pad(value, (0, 0) * (value.dim() - 1) + (0, extra), value=fill)
    return TensorDict(result, ())


def propagated(graph: SceneGraph) -> dict[str, Tensor]:
    """Two layers of Section V B on every feature, flattened, with fixed weights: [2N, 5]."""
    spread = normalise(graph.adjacency, graph.node_mask)
    outputs = {}
    for name in NODE_FEATURES:
        rows = node_features(graph, name).flatten(1)
        rows = torch.cat([rows, graph.scene_label[:, None]], dim=1)
        generator = torch.Generator().manual_seed(3)
        first = torch.randn(rows.shape[1], 7, generator=generator)
        second = torch.randn(7, 5, generator=generator)
        outputs[name] = spread @ torch.relu(spread @ (rows @ first + 1.0)) @ second
    return outputs


def assert_same(a: SceneGraph, b: SceneGraph) -> None:
    assert a.batch_size == b.batch_size
    assert bool((a == b).all())


@pytest.mark.parametrize("edges", EDGES)
def test_adjacency_of_two_and_three(edges: str) -> None:
    matrix = adjacency_matrix(*two_and_three(), edges)
    assert matrix.dtype == torch.float32
    assert matrix.tolist() == TWO_AND_THREE[edges]


def test_no_edge_leads_to_an_empty_node() -> None:
    """A match with an empty node counts for nothing, whichever side is empty."""
    masks = torch.tensor([True, False, True]), torch.tensor([False, True, True])
    matrix = adjacency_matrix(*masks, torch.tensor([0, 1, 2]), "complete")
    empty = [1, 3]
    assert matrix[empty].sum() == matrix[:, empty].sum() == 0
    assert matrix.nonzero().tolist() == [[0, 2], [2, 0], [2, 5], [4, 5], [5, 2], [5, 4]]


def test_scenes_of_different_size() -> None:
    node_mask, goal_node_mask, correspondence = two_and_three()
    matrix = adjacency_matrix(node_mask[:2], goal_node_mask, correspondence[:2], "complete")
    keep = [0, 1, 3, 4, 5]
    expected = torch.tensor(TWO_AND_THREE["complete"])[keep][:, keep]
    assert matrix.tolist() == expected.tolist()


def test_normalised_by_hand() -> None:
    """With self loops the degrees of two_and_three are 3, 3, 0, 4, 4, 3."""
    node_mask, goal_node_mask, correspondence = two_and_three()
    adjacency = adjacency_matrix(node_mask, goal_node_mask, correspondence, "complete")
    result = normalise(adjacency, torch.cat([node_mask, goal_node_mask]))
    a, b, c = 1 / 3, 1 / 4, 12**-0.5  # between degrees 3 and 3, 4 and 4, 3 and 4
    expected = [
        [a, a, 0, 0, c, 0],
        [a, a, 0, c, 0, 0],
        [0, 0, 0, 0, 0, 0],
        [0, c, 0, b, b, c],
        [c, 0, 0, b, b, c],
        [0, 0, 0, c, c, a],
    ]
    torch.testing.assert_close(result, torch.tensor(expected))


def test_normalised_without_any_object() -> None:
    nothing = normalise(torch.zeros(4, 4), torch.zeros(4).bool())
    assert nothing.tolist() == [[0.0] * 4] * 4
    alone = normalise(torch.zeros(2, 2), torch.tensor([False, True]))
    assert alone.tolist() == [[0, 0], [0, 1]]


def test_normalised_ignores_edges_to_empty_nodes() -> None:
    result = normalise(torch.ones(3, 3) - torch.eye(3), torch.tensor([True, False, True]))
    torch.testing.assert_close(result, torch.tensor([[0.5, 0, 0.5], [0, 0, 0], [0.5, 0, 0.5]]))


def test_graph_of_an_observation() -> None:
    td = observation(0)
    td["node_mask"] = torch.tensor([True, True, False, True])
    td["goal_node_mask"] = torch.tensor([False, True, True, True])
    graph = scene_graph(td, "complete")
    assert graph.sdf.shape == (8, SIZE, SIZE)
    assert graph.scene_label.tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert graph.node_mask.tolist() == [True, True, False, True, False, True, True, True]
    assert graph.correspondence.tolist() == td["correspondence"].tolist()
    for name in ("sdf", "center", "position"):
        rows = node_features(graph, name)
        assert torch.equal(rows[3], td[name][3])
        assert torch.equal(rows[5], td["goal_" + name][1])
        # The true position of an object that is not detected is known, but is no feature.
        assert rows[[2, 4]].abs().sum() == 0
        assert torch.equal(getattr(graph.goal, name), td["goal_" + name])
    assert torch.equal(graph.goal.node_mask, td["goal_node_mask"])
    inside = node_features(graph, "mask")
    assert inside.sum(dim=(1, 2)).tolist() == [16, 16, 0, 16, 0, 16, 16, 16]
    assert inside.dtype == torch.float32
    expected = adjacency_matrix(
        td["node_mask"], td["goal_node_mask"], td["correspondence"], "complete"
    )
    assert torch.equal(graph.adjacency, expected)


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("seed", range(3))
def test_padding_changes_nothing(seed: int, edges: str) -> None:
    small = scene_graph(observation(seed), edges)
    large = scene_graph(padded(observation(seed), 8), edges)
    rows = [*range(4), *range(8, 12)]
    assert torch.equal(small.adjacency, large.adjacency[rows][:, rows])
    for before, after in zip(propagated(small).values(), propagated(large).values(), strict=True):
        torch.testing.assert_close(before, after[rows])
        assert after[[4, 5, 6, 7, 12, 13, 14, 15]].abs().sum() == 0


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("seed", range(3))
def test_order_of_objects_permutes_the_graph(seed: int, edges: str) -> None:
    td = observation(seed)
    order, goal_order = torch.tensor([2, 0, 3, 1]), torch.tensor([1, 3, 2, 0])
    mixed = td.clone()
    for key, value in td.items():
        mixed[key] = value[goal_order if key.startswith("goal_") else order]
    # A goal node's new row is where the new order names it.
    new_row = torch.cat([goal_order.argsort(), torch.tensor([-1])])  # [-1] stays -1
    mixed["correspondence"] = new_row[td["correspondence"][order]]
    graph, other = scene_graph(td, edges), scene_graph(mixed, edges)
    rows = torch.cat([order, 4 + goal_order])
    assert torch.equal(other.adjacency, graph.adjacency[rows][:, rows])
    assert torch.equal(other.sdf, graph.sdf[rows])
    assert torch.equal(other.scene_label, graph.scene_label)
    for before, after in zip(propagated(graph).values(), propagated(other).values(), strict=True):
        torch.testing.assert_close(before[rows], after)


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("batch", [(5,), (2, 3)])
def test_a_batch_equals_one_by_one(batch: tuple[int, ...], edges: str) -> None:
    td = observation(1, 4, *batch)
    graphs = scene_graph(td, edges)
    assert graphs.batch_size == batch
    single = torch.stack([scene_graph(one, edges) for one in td.reshape(-1)])
    assert_same(graphs.reshape(-1), single)
    spread = normalise(graphs.adjacency, graphs.node_mask).flatten(0, len(batch) - 1)
    alone = torch.stack([normalise(one.adjacency, one.node_mask) for one in single])
    torch.testing.assert_close(spread, alone)


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("batch", [(), (3,)])
def test_another_goal(batch: tuple[int, ...], edges: str) -> None:
    """What comes out is the graph of an observation that had the other goal from the start."""
    before, after = observation(4, 4, *batch), observation(5, 4, *batch)
    achieved = before.clone()
    for key in ("sdf", "node_mask", "center", "position"):
        achieved["goal_" + key] = after[key]
    slots = torch.arange(4).expand(*batch, 4)
    same = torch.where(before["node_mask"] & after["node_mask"], slots, -1)
    achieved["correspondence"] = same
    graph = scene_graph(before, edges)
    kept = graph.clone()
    # `current` has zeros for what was not detected, so the raw goals agree up to there.
    other = with_goal(graph, scene_graph(after, edges).current, same, edges)
    assert_same(graph, kept)
    expected = scene_graph(achieved, edges)
    expected.goal = other.goal
    assert_same(other, expected)
    # And back again: the raw goal is all that it takes.
    assert_same(with_goal(other, kept.goal, kept.correspondence, edges), kept)


def test_names_that_there_are_not() -> None:
    with pytest.raises(SdfgcnError, match="edges is 'some', but must be one of complete, separate"):
        scene_graph(observation(0), "some")
    with pytest.raises(SdfgcnError, match="node_features is 'colour'"):
        node_features(scene_graph(observation(0), "complete"), "colour")


# ------------------------------------------------------------------ from the environment


@pytest.fixture(scope="module")
def env() -> Iterator[RearrangementEnv]:
    world = ("objects=household", "robot=gripper", "env.max_objects=5")
    environment = RearrangementEnv(real_config(*world, "env.perception.sdf=edt").env, seed=0)
    yield environment
    environment.close()


def test_specs(env: RearrangementEnv) -> None:
    check_env_specs(env, seed=0)


def test_graph_of_an_episode(env: RearrangementEnv) -> None:
    td = env.reset_episode(3)
    found = td["node_mask"] & td["goal_node_mask"]
    assert found.tolist() == [True, True, True, False, False]
    assert td["correspondence"].tolist() == [0, 1, 2, -1, -1]
    graph = scene_graph(td, "complete")
    assert graph.adjacency.sum(dim=1).tolist() == [3, 3, 3, 0, 0] * 2
    # A centre is read off a tilted picture: it errs by the objects' height.
    for prefix in ("", "goal_"):
        gap = (td[prefix + "center"] - td[prefix + "position"]).norm(dim=-1)
        assert gap[:3].max() < 0.05
        assert td[prefix + "center"][3:].abs().sum() == 0
    # The masks of the graph are those of the picture, and the SDFs those of the config.
    masks = env.episode_start.scene.masks
    assert (node_features(graph, "mask")[:3] == torch.from_numpy(masks)).all()
    expected = np.stack([signed_distance(mask, "edt") for mask in masks])
    np.testing.assert_array_equal(graph.sdf[:3].numpy(), expected)
    assert env.episode_start.goal.correspondence is None


def test_a_hidden_object_is_an_empty_node(
    env: RearrangementEnv, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sdfgcn.envs.rearrangement as rearrangement

    def all_but_the_second(masks: np.ndarray, min_pixels: int) -> np.ndarray:
        return np.arange(len(masks)) != 1

    td = env.reset_episode(3)
    td["action"] = torch.tensor(int(td["action_mask"].nonzero()[0]))
    monkeypatch.setattr(rearrangement, "detected", all_but_the_second)
    after = env.step(td)["next"]
    assert after["correspondence"].tolist() == [0, -1, 2, -1, -1]
    assert env.observation_spec["correspondence"].is_in(after["correspondence"])
    assert after["center"][1].tolist() == [0, 0]
    graph = scene_graph(after, "complete")
    assert graph.adjacency.sum(dim=1).tolist() == [2, 0, 2, 0, 0, 3, 2, 3, 0, 0]
    assert graph.sdf[1].abs().sum() == 0
    assert env.last_step.scene.correspondence.tolist() == [0, -1, 2]


def test_the_method_is_checked_before_anything_is_loaded() -> None:
    config = real_config("objects=household", "env.perception.sdf=exact").env
    with pytest.raises(SdfgcnError, match=r"env\.perception\.sdf is 'exact'"):
        RearrangementEnv(config)
