"""The scene graph: cases worked by hand, and what must not matter (padding, order, batches)."""

import pytest
import torch
from observations import random_observation
from torch import Tensor
from torch.nn.functional import pad

from sdfgcn.models.graph import EDGES, OccupiedNodes, adjacency_matrix, normalise

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


@pytest.mark.parametrize("edges", EDGES)
@pytest.mark.parametrize("count", [None, 3])
def test_mixing_the_occupied_nodes_is_the_padded_product(count: int | None, edges: str) -> None:
    """Graphs of different sizes are padded again to be multiplied, those of one size are not."""
    td = random_observation(2, 4, (6,), count, size=2)
    scene, goal, matched = td["scene"], td["goal"], td["matched"]
    nodes = OccupiedNodes(scene, goal, matched, edges)
    mask = torch.cat([scene.node_mask, goal.node_mask], dim=-1)
    rows = nodes.gather(scene.center, goal.center)
    assert torch.equal(rows, torch.cat([scene.center, goal.center], dim=1)[mask])
    assert torch.equal(nodes.is_goal, (torch.arange(8) >= 4).expand(6, 8)[mask])
    matrix = normalised((scene.node_mask, goal.node_mask, matched), edges)
    padded = torch.zeros(6, 8, 2)
    padded[mask] = rows
    torch.testing.assert_close(nodes.mix(rows, own=True), (matrix @ padded)[mask])
    diagonal = matrix.diagonal(dim1=1, dim2=2)
    torch.testing.assert_close(nodes.own_share(), diagonal[mask])
    others = matrix - torch.diag_embed(diagonal)
    torch.testing.assert_close(nodes.mix(rows, own=False), (others @ padded)[mask])
