"""The scene graph (paper sections V A and V B): two pictures as the nodes of one graph.

A graph has 2N nodes: the N rows of the current scene, then the N rows of the goal. Rows without
an object are empty nodes without edges, typically two thirds of all. Networks therefore process
occupied nodes only: empty ones cost nothing, and the content of their rows has no effect.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor

from sdfgcn.task.scene import Scene

# Whether the nodes of one picture are connected to each other: the paper's graph, and that of its
# ablation SDFGCN-separate.
EDGES: dict[str, bool] = {"complete": True, "separate": False}


class Shares(NamedTuple):
    """What a node gets of itself, of its partner, and of the mean of the others in its picture."""

    own: float
    partner: float
    others: float


# By kind of edges, what `normalise` gives three objects that all have partners.
FIXED_SHARES: dict[str, Shares] = {
    "complete": Shares(1 / 4, 1 / 4, 1 / 2),
    "separate": Shares(1 / 2, 1 / 2, 0.0),
}


def adjacency_matrix(
    node_mask: Tensor, goal_node_mask: Tensor, matched: Tensor, edges: str
) -> Tensor:
    """Edges within each picture and between matched objects (paper section V A).

    Args:
        node_mask: bool [*B, N] which rows of the current scene hold an object.
        goal_node_mask: bool [*B, N] which rows of the goal hold an object.
        matched: bool [*B, N] the rows in which both show the same object; empty rows always count
            as unmatched.
        edges: A key of `EDGES`. Matched objects are always connected.

    Returns:
        float32 [*B, 2N, 2N], symmetric, without self loops or edges at empty nodes.
    """
    matches = torch.diag_embed(matched & node_mask & goal_node_mask)
    within, goal_within = (
        _distinct_pairs(mask) if EDGES[edges] else torch.zeros_like(matches)
        for mask in (node_mask, goal_node_mask)
    )
    rows = torch.cat([within, matches], dim=-1)
    goal_rows = torch.cat([matches, goal_within], dim=-1)
    return torch.cat([rows, goal_rows], dim=-2).float()


def normalise(adjacency: Tensor, node_mask: Tensor) -> Tensor:
    """Symmetric normalisation with self loops, D^-1/2 (A + I) D^-1/2 (paper section V B).

    Empty nodes get no self loop: their rows and columns are zero, so nothing flows to or from
    them.

    Args:
        adjacency: float [*B, V, V], symmetric, without self loops or edges at empty nodes.
        node_mask: bool [*B, V] which nodes hold an object.

    Returns:
        float [*B, V, V].
    """
    looped = adjacency + torch.diag_embed(node_mask.float())
    scale = torch.where(node_mask, looped.sum(dim=-1).clamp(min=1.0).rsqrt(), 0.0)
    return scale.unsqueeze(-1) * looped * scale.unsqueeze(-2)


def with_fixed_shares(adjacency: Tensor, node_mask: Tensor, shares: Shares) -> Tensor:
    """Weights of the edges and self loops that do not depend on the number of objects.

    `normalise` gives a node of a complete graph 1/(n + 1) of each of n objects, its partner and
    itself, so what it knows of its own goal fades with n. Here, every node gets the same shares at
    any n. The share of what is not there, a partner or others, is left out, not passed on.

    Args:
        adjacency: As from `adjacency_matrix`.
        node_mask: bool [*B, 2N] which nodes hold an object.
        shares: The shares.

    Returns:
        float [*B, 2N, 2N].
    """
    nodes = torch.arange(node_mask.shape[-1], device=node_mask.device)
    is_goal = nodes >= len(nodes) // 2
    same_picture = is_goal.unsqueeze(-1) == is_goal
    others = adjacency * same_picture
    others = others / others.sum(dim=-1, keepdim=True).clamp(min=1.0)
    own = torch.diag_embed(node_mask.float())
    partner = adjacency * ~same_picture
    return shares.own * own + shares.partner * partner + shares.others * others


def _distinct_pairs(node_mask: Tensor) -> Tensor:
    """[*B, N, N] true for two different occupied nodes, from the node mask [*B, N]."""
    pairs = node_mask.unsqueeze(-1) & node_mask.unsqueeze(-2)
    return pairs & ~torch.eye(pairs.shape[-1], dtype=torch.bool, device=pairs.device)


class OccupiedNodes:
    """The nodes that the asked values depend on, as flat rows, and their edges layer by layer.

    A layer moves features by one edge. So the last one only has to compute the asked nodes, the
    one before it these and their neighbours, and so on down to the input. All is exact: what is
    left out has no path to an asked value.

    The M nodes of the input are the current scenes' before the goals', each ordered by graph.

    Attributes:
        hops: The edges of each layer, from the first to the last.
    """

    def __init__(
        self,
        scene: Scene,
        goal: Scene,
        matched: Tensor,
        edges: str,
        n_layers: int,
        asked: Tensor | None = None,
        fixed_shares: bool = False,
    ):
        """Build the graphs of scenes [B] and goals [B].

        Args:
            scene: Current scenes [B].
            goal: Goal scenes [B].
            matched: See `adjacency_matrix`.
            edges: See `adjacency_matrix`.
            n_layers: The number of propagation layers.
            asked: bool [B, N] the rows of the current scene that the last layer has to compute;
                all by default. Rows without an object are never computed.
            fixed_shares: Whether edges have the weights of `with_fixed_shares`, not `normalise`.
        """
        here, there = scene.node_mask, goal.node_mask
        asked = here if asked is None else asked & here
        adjacency = adjacency_matrix(here, there, matched, edges)
        mask = torch.cat([here, there], dim=-1)
        if fixed_shares:
            matrix = with_fixed_shares(adjacency, mask, FIXED_SHARES[edges])
        else:
            matrix = normalise(adjacency, mask)
        uses = _uses(adjacency, torch.cat([asked, torch.zeros_like(there)], dim=-1), n_layers)
        # In this order, every layer's nodes are the first ones of each graph.
        order = uses.argsort(dim=-1, descending=True, stable=True)
        uses, n = uses.gather(1, order), here.shape[-1]
        source = _Level(uses > 0, late=order >= n)
        levels = [source, *(_Level(uses > layer) for layer in range(1, n_layers + 1))]
        order = order[:, : source.width]
        matrix = matrix.gather(1, order.unsqueeze(-1).expand(-1, -1, matrix.shape[-1]))
        matrix = matrix.gather(2, order.unsqueeze(1).expand(-1, source.width, -1))
        self.hops = [Hop(matrix, *pair) for pair in pairwise(levels)]
        node = source.flat(order)
        place = source.graph * n + node % n  # of each node in [B * N] rows of its scene
        self._here, self._there = place[node < n], place[node >= n]

    def gather(self, current: Tensor, goal: Tensor) -> tuple[Tensor, Tensor]:
        """Copy the input's features [M_current, ...], [M_goal, ...] from padded ones [B, N, ...].

        Concatenated, they are the M nodes in order.
        """
        return current.flatten(0, 1)[self._here], goal.flatten(0, 1)[self._there]


def _uses(adjacency: Tensor, asked: Tensor, n_layers: int) -> Tensor:
    """How many of the layers' inputs and outputs each node has to be in, int [B, V].

    Asked nodes [B, V] are in all n_layers + 1, their neighbours in all but the last, and so on.
    """
    uses = asked.int()
    for _ in range(n_layers):
        asked = asked | ((adjacency > 0) & asked.unsqueeze(-2)).any(dim=-1)
        uses = uses + asked
    return uses


class _Level:
    """The nodes that go into or come out of a layer, as flat rows.

    Attributes:
        width: The largest number of nodes of any graph.
        count: The number of nodes of all graphs.
        graph: int64 [count] the graph of each node.
    """

    def __init__(self, chosen: Tensor, late: Tensor | None = None):
        """Take the nodes `chosen`, bool [B, V], by graph, but `late` ones, bool [B, V], at the end.

        The chosen ones come first in each graph.
        """
        self.width = int(chosen.sum(dim=-1).amax()) if len(chosen) else 0
        self._shape = len(chosen), self.width
        chosen = chosen[:, : self.width].flatten()
        place = chosen.nonzero().squeeze(-1)
        if late is not None:
            at_end = late[:, : self.width].flatten()[place]
            place = torch.cat([place[~at_end], place[at_end]])
        self.count = len(place)
        self.graph = place // max(self.width, 1)
        # None: as many nodes in every graph, in order.
        self._place = place if late is not None or self.count < len(chosen) else None

    def flat(self, padded: Tensor) -> Tensor:
        """[count, ...] of at least [B, width, ...]."""
        rows = padded[:, : self.width].flatten(0, 1)
        return rows if self._place is None else rows.index_select(0, self._place)

    def padded(self, rows: Tensor) -> Tensor:
        """[B, width, ...] of [count, ...], zero where a graph has fewer nodes."""
        if self._place is not None:
            zeros = rows.new_zeros(self._shape[0] * self.width, *rows.shape[1:])
            rows = zeros.index_copy_(0, self._place, rows)
        return rows.reshape(*self._shape, *rows.shape[1:])


class Hop:
    """The edges of one layer: from the nodes that it reads to those that it computes.

    Attributes:
        own_share: [M_out] the diagonal of the matrix: the weight of each computed node's own
            features.
    """

    def __init__(self, matrix: Tensor, source: _Level, target: _Level):
        """Take the edges' weights [B, V, V] of nodes in order, those to read and to write."""
        self._source, self._target = source, target
        self._matrix = matrix[:, : target.width, : source.width]
        self.own_share = target.flat(self._matrix.diagonal(dim1=1, dim2=2))
        # Where the computed nodes are among those read.
        self._own = target.flat(source.padded(torch.arange(source.count, device=matrix.device)))

    def own(self, rows: Tensor) -> Tensor:
        """The computed nodes' own features [M_out, ...] of those read [M, ...]."""
        return _by_row(rows, lambda flat: flat.index_select(0, self._own))

    def mix(self, rows: Tensor, own: bool) -> Tensor:
        """Multiply the edges' weights by the nodes' features (paper section V B).

        Args:
            rows: [M, ...].
            own: Whether to include a node's own features; if not, the diagonal is taken as zero.

        Returns:
            [M_out, ...].
        """
        matrix = self._matrix.to(rows.dtype)
        if not own:
            diagonal = torch.eye(*matrix.shape[1:], dtype=torch.bool, device=matrix.device)
            matrix = matrix.masked_fill(diagonal, 0.0)
        return _by_row(rows, lambda flat: self._target.flat(matrix @ self._source.padded(flat)))


def _by_row(rows: Tensor, change: Callable[[Tensor], Tensor]) -> Tensor:
    """Apply a function of [M, F] to features [M, ...]; channels-last pictures stay so, uncopied."""
    last = rows.dim() == 4 and rows.is_contiguous(memory_format=torch.channels_last)
    if last:
        rows = rows.permute(0, 2, 3, 1)
    changed = change(rows.flatten(1)).unflatten(1, rows.shape[1:])
    return changed.permute(0, 3, 1, 2) if last else changed
