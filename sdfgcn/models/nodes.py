"""The occupied nodes of a batch of scene graphs as plain rows, and how they mix along edges.

Pictures are padded to N nodes, but mostly a third of these hold an object. Convolutions see the
occupied ones alone: empty nodes cost nothing, and whatever their rows hold has no effect.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from sdfgcn.graph import adjacency_matrix, normalise

GRAPH_KEYS = ("goal_node_mask", "correspondence")  # what the graph takes besides `node_mask`


class OccupiedNodes:
    """The M occupied nodes of B graphs with 2N nodes each.

    Rows stand graph by graph; within one, the current picture's nodes come before the goal's.

    Attributes:
        is_goal: bool [M], the scene label.
        is_current: bool [M], its opposite.
    """

    def __init__(self, observation: Mapping[str, Tensor], edges: str):
        """Build the graphs.

        Args:
            observation: `node_mask`, `goal_node_mask` bool [B, N] and `correspondence` int64
                [B, N].
            edges: As for `sdfgcn.graph.scene_graph`.
        """
        here, there = observation["node_mask"], observation["goal_node_mask"]
        mask = torch.cat([here, there], dim=-1)
        adjacency = adjacency_matrix(here, there, observation["correspondence"], edges)
        n_nodes = mask.sum(dim=-1)
        # Each graph is cut to the most nodes that any of them has: occupied ones first, in order.
        self._width = int(n_nodes.max()) if len(mask) else 0
        order = mask.int().argsort(dim=-1, descending=True, stable=True)[:, : self._width]
        matrix = normalise(adjacency, mask)
        matrix = matrix.gather(1, order.unsqueeze(-1).expand(-1, -1, matrix.shape[-1]))
        self._matrix = matrix.gather(2, order.unsqueeze(1).expand(-1, self._width, -1))
        kept = mask.gather(1, order)
        self._kept = None if bool(kept.all()) else kept  # where None, [B, width] is [M]
        self._shape = kept.shape
        self.is_goal = (order >= here.shape[-1])[kept]
        self.is_current = ~self.is_goal
        self._here, self._there = here, there

    def gather(self, current: Tensor, goal: Tensor) -> Tensor:
        """Take the occupied nodes' features out of the padded ones.

        Args:
            current: [B, N, ...] a feature of the current picture's nodes.
            goal: The same of the goal's.

        Returns:
            [M, ...], memory of its own.
        """
        rows = current.new_empty(len(self.is_goal), *current.shape[2:])
        rows[self.is_current] = current[self._here]
        rows[self.is_goal] = goal[self._there]
        return rows

    def own_share(self) -> Tensor:
        """[M] the diagonal of D^-1/2 (A + I) D^-1/2: how much of itself a node gets."""
        share = self._matrix.diagonal(dim1=1, dim2=2)
        return share.flatten() if self._kept is None else share[self._kept]

    def mix(self, rows: Tensor, own: bool) -> Tensor:
        """Multiply D^-1/2 (A + I) D^-1/2 by the nodes' features (paper section V B).

        Args:
            rows: [M, ...].
            own: Whether a node's own features take part; if not, the diagonal counts as zero.

        Returns:
            [M, ...].
        """
        if rows.dim() == 4 and rows.is_contiguous(memory_format=torch.channels_last):
            last = rows.permute(0, 2, 3, 1)  # a view that `reshape` need not copy
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
