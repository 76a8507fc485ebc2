"""The scene graph: cases worked by hand, and what must not matter (padding, order, batches)."""

import pytest
import torch
from observations import random_observation
from torch import Tensor
from torch.nn.functional import pad

from sdfgcn.models.graph import (
    EDGES,
    FIXED_SHARES,
    OccupiedNodes,
    adjacency_matrix,
    normalise,
    with_fixed_shares,
)

# Two current objects, three in the goal, N = 3: rows 0 and 1 are matched, and goal 2 has no
# partner. Nodes: 0 and 1, 2 empty, and 3 to 5 the goal's.
TWO_AND_THREE = {
    "complete": [
        [0, 1, 0, 1, 0, 0],
        [1, 0, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, 0],
        [1, 0, 0, 0, 1, 1],
        [0, 1, 0, 1, 0, 1],
        [0, 0, 0, 1, 1, 0],
    ],
    "separate": [
        [0, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 1, 0],
        [0, 0, 0, 0, 0, 0],
        [1, 0, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0],
    ],
}


def two_and_three() -> tuple[Tensor, Tensor, Tensor]:
    """Node mask, goal node mask, which rows are matched."""
    return torch.tensor([1, 1, 0]).bool(), torch.ones(3).bool(), torch.tensor([1, 1, 0]).bool()


def random_masks(seed: int, *batch: int) -> tuple[Tensor, Tensor, Tensor]:
    """The same for four rows, at random."""
    td = random_observation(seed, 4, batch, size=2)
    return td["scene"].node_mask, td["goal"].node_mask, td["matched"]


def normalised(masks: tuple[Tensor, Tensor, Tensor], edges: str) -> Tensor:
    return normalise(adjacency_matrix(*masks, edges), torch.cat(masks[:2], dim=-1))


def with_shares(masks: tuple[Tensor, Tensor, Tensor], edges: str) -> Tensor:
    adjacency, mask = adjacency_matrix(*masks, edges), torch.cat(masks[:2], dim=-1)
    return with_fixed_shares(adjacency, mask, FIXED_SHARES[edges])


@pytest.mark.parametrize("edges", EDGES)
def test_adjacency_of_two_and_three(edges: str) -> None:
    matrix = adjacency_matrix(*two_and_three(), edges)
    assert matrix.dtype == torch.float32
    assert matrix.tolist() == TWO_AND_THREE[edges]


def test_no_edge_leads_to_an_empty_node() -> None:
    """A match with an empty node counts for nothing, whichever side is empty."""
    masks = torch.tensor([True, False, True]), torch.tensor([False, True, True])
    matrix = adjacency_matrix(*masks, torch.ones(3).bool(), "complete")
    empty = [1, 3]
    assert matrix[empty].sum() == matrix[:, empty].sum() == 0
    assert matrix.nonzero().tolist() == [[0, 2], [2, 0], [2, 5], [4, 5], [5, 2], [5, 4]]


def test_normalised_by_hand() -> None:
    """With self loops the degrees of two_and_three are 3, 3, 0, 4, 4, 3."""
    a, b, c = 1 / 3, 1 / 4, 12**-0.5  # between degrees 3 and 3, 4 and 4, 3 and 4
    expected = [
        [a, a, 0, c, 0, 0],
        [a, a, 0, 0, c, 0],
        [0, 0, 0, 0, 0, 0],
        [c, 0, 0, b, b, c],
        [0, c, 0, b, b, c],
        [0, 0, 0, c, c, a],
    ]
    torch.testing.assert_close(normalised(two_and_three(), "complete"), torch.tensor(expected))


@pytest.mark.parametrize(
    ("edges", "expected"),
    [
        (
            "complete",  # rows 3 to 5: the mean of two others has a half
            [
                [1 / 4, 1 / 2, 0, 1 / 4, 0, 0],
                [1 / 2, 1 / 4, 0, 0, 1 / 4, 0],
                [0, 0, 0, 0, 0, 0],
                [1 / 4, 0, 0, 1 / 4, 1 / 4, 1 / 4],
                [0, 1 / 4, 0, 1 / 4, 1 / 4, 1 / 4],
                [0, 0, 0, 1 / 4, 1 / 4, 1 / 4],
            ],
        ),
        (
            "separate",
            [
                [1 / 2, 0, 0, 1 / 2, 0, 0],
                [0, 1 / 2, 0, 0, 1 / 2, 0],
                [0, 0, 0, 0, 0, 0],
                [1 / 2, 0, 0, 1 / 2, 0, 0],
                [0, 1 / 2, 0, 0, 1 / 2, 0],
                [0, 0, 0, 0, 0, 1 / 2],
            ],
        ),
    ],
)
def test_fixed_shares_by_hand(edges: str, expected: list[list[float]]) -> None:
    masks = two_and_three()
    assert with_shares(masks, edges).tolist() == expected


@pytest.mark.parametrize("edges", EDGES)
def test_fixed_shares_of_three_are_the_normalised(edges: str) -> None:
    masks = (torch.tensor([True, False, True, True]),) * 3
    torch.testing.assert_close(with_shares(masks, edges), normalised(masks, edges))


@pytest.mark.parametrize("count", [1, 2, 5])
def test_fixed_shares_are_the_same_for_any_number(count: int) -> None:
    matrix = with_shares((torch.ones(count).bool(),) * 3, "complete")
    torch.testing.assert_close(matrix.diagonal(), torch.full((2 * count,), 1 / 4))
    torch.testing.assert_close(matrix.diagonal(count), torch.full((count,), 1 / 4))
    rest = 0.0 if count == 1 else 1 / 2
    torch.testing.assert_close(matrix.sum(-1), torch.full((2 * count,), 1 / 2 + rest))


def test_normalised_without_any_object() -> None:
    nothing = normalise(torch.zeros(4, 4), torch.zeros(4).bool())
    assert nothing.tolist() == [[0.0] * 4] * 4
    alone = normalise(torch.zeros(2, 2), torch.tensor([False, True]))
    assert alone.tolist() == [[0, 0], [0, 1]]


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("seed", range(3))
def test_padding_changes_nothing(seed: int, edges: str) -> None:
    masks = random_masks(seed)
    here, there, matched = (pad(mask, (0, 4)) for mask in masks)
    large = normalised((here, there, matched), edges)
    rows = [*range(4), *range(8, 12)]
    assert torch.equal(normalised(masks, edges), large[rows][:, rows])
    empty = [4, 5, 6, 7, 12, 13, 14, 15]
    assert large[empty].abs().sum() == large[:, empty].abs().sum() == 0


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("seed", range(3))
def test_order_of_objects_permutes_the_graph(seed: int, edges: str) -> None:
    masks, order = random_masks(seed), torch.tensor([2, 0, 3, 1])
    here, there, matched = (mask[order] for mask in masks)
    rows = torch.cat([order, 4 + order])
    expected = normalised(masks, edges)[rows][:, rows]
    assert torch.equal(normalised((here, there, matched), edges), expected)


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("batch", [(5,), (2, 3)])
def test_a_batch_equals_one_by_one(batch: tuple[int, ...], edges: str) -> None:
    here, there, matched = random_masks(1, *batch)
    together = normalised((here, there, matched), edges).flatten(0, len(batch) - 1)
    one_by_one = zip(*(mask.reshape(-1, 4) for mask in (here, there, matched)), strict=True)
    assert torch.equal(together, torch.stack([normalised(masks, edges) for masks in one_by_one]))


def nodes_in_order(masks: tuple[Tensor, Tensor, Tensor], layer: int, edges: str) -> list[list[int]]:
    """By graph, the nodes that go into a layer of two: from the definition, by following edges."""
    matrix = adjacency_matrix(*masks, edges) + torch.eye(2 * masks[0].shape[-1])
    asked = torch.cat([masks[0], torch.zeros_like(masks[0])], dim=-1).float()
    needed = (torch.linalg.matrix_power(matrix, 2 - layer) @ asked.unsqueeze(-1)).squeeze(-1)
    return [row.nonzero().flatten().tolist() for row in needed]


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("count", [None, 3])
def test_mixing_the_nodes_is_the_padded_product(count: int | None, edges: str) -> None:
    """Of any layer's nodes, in graphs of different sizes or of one size."""
    td = random_observation(2, 4, (6,), count, size=2)
    scene, goal, matched = td["scene"], td["goal"], td["matched"]
    masks = scene.node_mask, goal.node_mask, matched
    nodes = OccupiedNodes(*(scene, goal, matched), edges, n_layers=2)
    padded = torch.cat([scene.center, goal.center], dim=1)
    matrix = normalised(masks, edges)
    diagonal = matrix.diagonal(dim1=1, dim2=2)
    others = matrix - torch.diag_embed(diagonal)
    inside = [nodes_in_order(masks, layer, edges) for layer in range(3)]
    rows = torch.cat(nodes.gather(scene.center, goal.center))
    assert by_value(rows) == by_value(chosen(padded, inside[0]))
    for hop, computed in zip(nodes.hops, inside[1:], strict=True):
        for own, product in ((True, matrix @ padded), (False, others @ padded)):
            assert by_value(hop.mix(rows, own)) == by_value(chosen(product, computed))
        rows = hop.own(rows)
        assert by_value(rows) == by_value(chosen(padded, computed))
        shares = chosen(diagonal.unsqueeze(-1) * padded, computed)
        assert by_value(hop.own_share.unsqueeze(-1) * rows) == by_value(shares)


def chosen(padded: Tensor, nodes: list[list[int]]) -> Tensor:
    """The rows [M, F] of a padded [B, V, F] at the nodes of each graph."""
    return torch.cat([graph[which] for graph, which in zip(padded, nodes, strict=True)])


def by_value(rows: Tensor) -> list[tuple[float, ...]]:
    """Rows in an order that does not depend on that of the nodes."""
    return sorted(tuple(round(value, 5) + 0.0 for value in row) for row in rows.tolist())
