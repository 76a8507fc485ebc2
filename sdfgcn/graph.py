"""The SDF scene graph (paper sections V A and V B): two pictures as the nodes of one graph.

Built in pure torch from an environment's TensorDict of any batch shape, so that a replay buffer
holds plain observations and a model builds the graph of a whole batch at once. N is the number
of nodes that each picture is padded to; of the 2N nodes of a graph the first N belong to the
current picture and the last N to the goal. `*B` stands for the batch shape.

An observation for the graph has these keys, the goal's with the prefix `goal_`: `sdf`
[*B, N, H, W], `node_mask` bool [*B, N], `center` and `position` [*B, N, 2]; and
`correspondence` int64 [*B, N].
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorClass, TensorDictBase
from torch import Tensor

from sdfgcn.config import lookup

# Whether the nodes of one picture are connected with each other: the paper's graph, and that of
# its ablation SDFGCN-separate.
EDGES: dict[str, bool] = {"complete": True, "separate": False}


class SceneNodes(TensorClass):
    """What one picture shows, before it becomes part of a graph.

    Attributes:
        sdf: float32 [*B, N, H, W] signed distances, pixels, negative inside.
        node_mask: bool [*B, N] which rows hold a detected object.
        center: float32 [*B, N, 2] detected centre on the table, metres.
        position: float32 [*B, N, 2] true centre, metres.
    """

    sdf: Tensor
    node_mask: Tensor
    center: Tensor
    position: Tensor


class SceneGraph(TensorClass):
    """A current and a goal picture as one graph.

    Rows of empty nodes are zero in all node features, and empty nodes have no edge.

    Attributes:
        sdf: float32 [*B, 2N, H, W] signed distances, pixels, negative inside.
        center: float32 [*B, 2N, 2] detected centre on the table, metres.
        position: float32 [*B, 2N, 2] true centre, metres.
        scene_label: float32 [*B, 2N] 0 for the current picture's nodes, 1 for the goal's.
        node_mask: bool [*B, 2N] which nodes hold a detected object.
        adjacency: float32 [*B, 2N, 2N] symmetric, 1 for an edge, without self loops.
        correspondence: int64 [*B, N] for each current node the goal node (0 to N - 1) that it is
            matched with, -1 for none.
        goal: The goal's nodes as they were handed in; `with_goal` puts others in their place.
    """

    sdf: Tensor
    center: Tensor
    position: Tensor
    scene_label: Tensor
    node_mask: Tensor
    adjacency: Tensor
    correspondence: Tensor
    goal: SceneNodes

    @property
    def current(self) -> SceneNodes:
        """The current picture's nodes; as another graph's goal they make hindsight."""
        n = self.correspondence.shape[-1]
        return SceneNodes(
            sdf=self.sdf[..., :n, :, :],
            node_mask=self.node_mask[..., :n],
            center=self.center[..., :n, :],
            position=self.position[..., :n, :],
            batch_size=self.batch_size,
        )


NODE_FEATURES: dict[str, Callable[[SceneGraph], Tensor]] = {
    "sdf": lambda graph: graph.sdf,
    "mask": lambda graph: (graph.sdf < 0.0).to(graph.sdf.dtype),
    "center": lambda graph: graph.center,
    "position": lambda graph: graph.position,
}


def node_features(graph: SceneGraph, name: str) -> Tensor:
    """What stands for each node in a network (paper sections V A and VI B).

    Args:
        graph: Of any batch shape.
        name: "sdf" for SDFGCN; "mask", 1 inside an object, for Segmentation GCN; "center", the
            detected one in metres, for Pose GCN; "position", the true one, for GT-Pose GCN.

    Returns:
        float32 [*B, 2N, H, W] for "sdf" and "mask", else [*B, 2N, 2]; the scene label is apart.

    Raises:
        SdfgcnError: There is no such feature.
    """
    return lookup(NODE_FEATURES, "node_features", name)(graph)


def scene_graph(observation: TensorDictBase, edges: str) -> SceneGraph:
    """Build the graph of an environment's observation.

    Args:
        observation: Of any batch shape, with the keys that the module names.
        edges: "complete" connects all nodes of one picture with each other; "separate" leaves
            these edges out. Matched objects are connected either way.

    Raises:
        SdfgcnError: `edges` is neither of them.
        KeyError: The observation lacks a key.
    """
    current, goal = _nodes(observation, prefix=""), _nodes(observation, prefix="goal_")
    return _join(current, goal, observation["correspondence"], edges)


def with_goal(
    graph: SceneGraph, goal: SceneNodes, correspondence: Tensor, edges: str
) -> SceneGraph:
    """The same current picture with another goal, as hindsight needs it (paper section V C).

    Args:
        graph: Left as it is.
        goal: The new goal's nodes, of the same batch shape and N: often `current` of a later
            graph, or `graph.goal` with some rows replaced.
        correspondence: int64 [*B, N] the match between the current nodes and the new goal's.
        edges: As for `scene_graph`.

    Raises:
        SdfgcnError: `edges` names nothing.
    """
    return _join(graph.current, goal, correspondence, edges)


def adjacency_matrix(
    node_mask: Tensor, goal_node_mask: Tensor, correspondence: Tensor, edges: str
) -> Tensor:
    """Edges within each picture and between matched objects (paper section V A).

    Args:
        node_mask: bool [*B, M] which current nodes hold an object.
        goal_node_mask: bool [*B, N] which goal nodes do.
        correspondence: int64 [*B, M] for each current node its goal node, -1 for none; no goal
            node twice. A match of an empty node counts for nothing.
        edges: As for `scene_graph`.

    Returns:
        float32 [*B, M + N, M + N], symmetric, without self loops and without edges at empty
        nodes.

    Raises:
        SdfgcnError: `edges` names nothing.
    """
    goal_nodes = torch.arange(goal_node_mask.shape[-1], device=correspondence.device)
    matches = correspondence.unsqueeze(-1) == goal_nodes
    matches = matches & _pairs(node_mask, goal_node_mask)
    within, goal_within = _pairs(node_mask, node_mask), _pairs(goal_node_mask, goal_node_mask)
    if lookup(EDGES, "edges", edges):
        within, goal_within = _without_diagonal(within), _without_diagonal(goal_within)
    else:
        within, goal_within = torch.zeros_like(within), torch.zeros_like(goal_within)
    rows = torch.cat([within, matches], dim=-1)
    goal_rows = torch.cat([matches.mT, goal_within], dim=-1)
    return torch.cat([rows, goal_rows], dim=-2).float()


def normalise(adjacency: Tensor, node_mask: Tensor) -> Tensor:
    """Symmetric normalisation with self loops, D^-1/2 (A + I) D^-1/2 (paper section V B).

    Empty nodes get no self loop: their rows and columns are zero, so that nothing flows from
    them or into them.

    Args:
        adjacency: float [*B, V, V] without self loops.
        node_mask: bool [*B, V] which nodes hold an object.

    Returns:
        float [*B, V, V].
    """
    looped = adjacency * _pairs(node_mask, node_mask) + torch.diag_embed(node_mask.float())
    degree = looped.sum(dim=-1)
    scale = torch.where(node_mask, degree.clamp(min=1.0).rsqrt(), 0.0)
    return scale.unsqueeze(-1) * looped * scale.unsqueeze(-2)


def _nodes(observation: TensorDictBase, prefix: str) -> SceneNodes:
    return SceneNodes(
        sdf=observation[prefix + "sdf"],
        node_mask=observation[prefix + "node_mask"],
        center=observation[prefix + "center"],
        position=observation[prefix + "position"],
        batch_size=observation.batch_size,
    )


def _join(current: SceneNodes, goal: SceneNodes, correspondence: Tensor, edges: str) -> SceneGraph:
    node_mask = torch.cat([current.node_mask, goal.node_mask], dim=-1)
    joined = {
        name: _emptied(torch.cat([here, there], dim=len(current.batch_size)), node_mask)
        for name, here, there in (
            ("sdf", current.sdf, goal.sdf),
            ("center", current.center, goal.center),
            ("position", current.position, goal.position),
        )
    }
    label = torch.cat(
        [torch.zeros_like(current.node_mask), torch.ones_like(goal.node_mask)], dim=-1
    )
    return SceneGraph(
        **joined,
        scene_label=label.to(current.sdf.dtype),
        node_mask=node_mask,
        adjacency=adjacency_matrix(current.node_mask, goal.node_mask, correspondence, edges),
        correspondence=correspondence,
        goal=goal,
        batch_size=current.batch_size,
    )


def _emptied(rows: Tensor, node_mask: Tensor) -> Tensor:
    """The rows [*B, V, ...], zero where no object is."""
    mask = node_mask.reshape(*node_mask.shape, *(1,) * (rows.dim() - node_mask.dim()))
    return torch.where(mask, rows, 0.0)


def _pairs(rows: Tensor, columns: Tensor) -> Tensor:
    """[*B, M, N] where both nodes hold an object, from [*B, M] and [*B, N]."""
    return rows.unsqueeze(-1) & columns.unsqueeze(-2)


def _without_diagonal(pairs: Tensor) -> Tensor:
    return pairs & ~torch.eye(pairs.shape[-1], dtype=torch.bool, device=pairs.device)
