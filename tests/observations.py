"""Observations made up for tests of what reads them: networks and agents."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from tensordict import TensorDict
from torch import Tensor

from sdfgcn.task.scene import Scene


def random_scene(
    generator: torch.Generator, n: int, batch: Iterable[int], count: int | None, size: int
) -> Scene:
    """Random SDFs and points, also in rows without an object; the objects sit in random rows.

    Args:
        generator: Where all is drawn from.
        n: Rows.
        batch: The batch shape.
        count: Objects in each scene; a random number for each, from 1 to n, if None.
        size: Height and width of the pictures, pixels.
    """
    shape = (*batch, n)
    center, position = (torch.rand(*shape, 2, generator=generator) * 0.5 - 0.25 for _ in range(2))
    rank = torch.rand(shape, generator=generator).argsort(-1).argsort(-1)
    most = torch.randint(1, n + 1, (*shape[:-1], 1), generator=generator)
    return Scene(
        sdf=torch.randn(*shape, size, size, generator=generator) * 20 + 10,
        node_mask=rank < (most if count is None else count),
        center=center,
        position=position,
        batch_size=shape[:-1],
    )


def random_observation(
    seed: int, n: int = 4, batch: Iterable[int] = (), count: int | None = None, size: int = 24
) -> TensorDict:
    """What networks read: scenes of `random_scene`, with most of the common rows matched."""
    generator = torch.Generator().manual_seed(seed)
    batch = tuple(batch)
    scene, goal = (random_scene(generator, n, batch, count, size) for _ in range(2))
    likely = torch.rand(*batch, n, generator=generator) < 0.8
    matched = likely & scene.node_mask & goal.node_mask
    return TensorDict({"scene": scene, "goal": goal, "matched": matched}, batch)


def observation_at(
    here: Iterable[tuple[float, float]],
    there: Iterable[tuple[float, float]],
    n: int = 8,
    n_directions: int = 8,
    size: int = 96,
) -> TensorDict:
    """One observation with objects at given points, metres, all matched and free to be pushed.

    Args:
        here: Where each object is, and is seen.
        there: Where it belongs.
        n: Rows; those after the objects are empty.
        n_directions: D.
        size: Height and width of the pictures, which show nothing, pixels.
    """
    scene, goal = (_scene_at(list(points), n, size) for points in (here, there))
    return TensorDict(
        {
            "scene": scene,
            "goal": goal,
            "matched": scene.node_mask.clone(),
            "action_mask": scene.node_mask.repeat_interleave(n_directions),
            "pushes": torch.zeros(1, dtype=torch.int64),
        }
    )


def _scene_at(points: list[tuple[float, float]], n: int, size: int) -> Scene:
    places: Tensor = torch.zeros(n, 2)
    places[: len(points)] = torch.tensor(points)
    return Scene(
        sdf=torch.ones(n, size, size),
        node_mask=torch.arange(n) < len(points),
        center=places,
        position=places.clone(),
        batch_size=[],
    )
