"""The scene graph (paper sections V A and V B): two pictures as the nodes of one graph.

A graph has 2N nodes: the N rows of the current scene, then the N rows of the goal. Rows without
an object are empty nodes without edges, typically two thirds of all. Networks therefore process
occupied nodes only: empty ones cost nothing, and the content of their rows has no effect.
"""

from __future__ import annotations

import torch
from torch import Tensor

from sdfgcn.task.scene import Scene

# Whether the nodes of one picture are connected to each other: the paper's graph, and that of its
# ablation SDFGCN-separate.
EDGES: dict[str, bool] = {"complete": True, "separate": False}


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


def _distinct_pairs(node_mask: Tensor) -> Tensor:
    """[*B, N, N] true for two different occupied nodes, from the node mask [*B, N]."""
    pairs = node_mask.unsqueeze(-1) & node_mask.unsqueeze(-2)
    return pairs & ~torch.eye(pairs.shape[-1], dtype=torch.bool, device=pairs.device)


class OccupiedNodes:
    """The M occupied nodes of B graphs as flat rows, and their propagation along edges.

    The nodes are ordered by graph; within a graph, the current scene's come before the goal's.

    Attributes:
        is_goal: bool [M], the scene label.
        is_current: bool [M], the negation of `is_goal`.
    """

    def __init__(self, scene: Scene, goal: Scene, matched: Tensor, edges: str):
        """Build the graphs of scenes [B] and goals [B]; for the rest see `adjacency_matrix`."""
        here, there = scene.node_mask, goal.node_mask
        mask = torch.cat([here, there], dim=-1)
        n_nodes = mask.sum(dim=-1)
        # All graphs are cut to the largest number of nodes of any: occupied ones first, in order.
        self._width = int(n_nodes.max()) if len(mask) else 0
        order = mask.int().argsort(dim=-1, descending=True, stable=True)[:, : self._width]
        matrix = normalise(adjacency_matrix(here, there, matched, edges), mask)
        matrix = matrix.gather(1, order.unsqueeze(-1).expand(-1, -1, matrix.shape[-1]))
        self._matrix = matrix.gather(2, order.unsqueeze(1).expand(-1, self._width, -1))
        kept = mask.gather(1, order)
        self._kept = None if bool(kept.all()) else kept  # None: all of [B, width] are occupied
        self._shape = kept.shape
        self.is_goal = (order >= here.shape[-1])[kept]
        self.is_current = ~self.is_goal
        self._here, self._there = here, there

    def gather(self, current: Tensor, goal: Tensor) -> Tensor:
        """Copy the occupied nodes' features [M, ...] from padded ones [B, N, ...]."""
        rows = current.new_empty(len(self.is_goal), *current.shape[2:])
        rows[self.is_current] = current[self._here]
        rows[self.is_goal] = goal[self._there]
        return rows

    def own_share(self) -> Tensor:
        """[M] the diagonal of D^-1/2 (A + I) D^-1/2: the weight of each node's own features."""
        share = self._matrix.diagonal(dim1=1, dim2=2)
        return share.flatten() if self._kept is None else share[self._kept]

    def mix(self, rows: Tensor, own: bool) -> Tensor:
        """Multiply D^-1/2 (A + I) D^-1/2 by the nodes' features (paper section V B).

        Args:
            rows: [M, ...].
            own: Whether to include a node's own features; if not, the diagonal is taken as zero.

        Returns:
            [M, ...].
        """
        if rows.dim() == 4 and rows.is_contiguous(memory_format=torch.channels_last):
            last = rows.permute(0, 2, 3, 1)  # a view that `reshape` does not copy
            if last.is_contiguous():
                return self._mix(last, own).permute(0, 3, 1, 2)
        return self._mix(rows, own)

    def _mix(self, rows: Tensor, own: bool) -> Tensor:
        matrix = self._matrix
        if not own:
            matrix = matrix - torch.diag_embed(matrix.diagonal(dim1=1, dim2=2))
        flat = rows.flatten(1)
        if self._kept is None:
            padded = flat.reshape(*self._shape, flat.shape[-1])
        else:
            padded = flat.new_zeros(*self._shape, flat.shape[-1])
            padded[self._kept] = flat
        mixed = matrix.to(padded.dtype) @ padded
        mixed = mixed.flatten(0, 1) if self._kept is None else mixed[self._kept]
        return mixed.reshape(rows.shape)
