"""Arrangements of training objects, rendered with true labels.

Objects lie apart, touch, or are stacked. Each arrangement is pictured in several looks, because a
new look costs far less than settling a new arrangement.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from shapely import Polygon
from shapely.affinity import translate

from sdfgcn.config import ArrangementsConfig, EnvConfig
from sdfgcn.objects.model import ObjectModel, Rest
from sdfgcn.segmentation.appearance import Appearance, paint
from sdfgcn.sim.episode import EpisodeSpec, draw_rest, turned
from sdfgcn.sim.placement import footprint
from sdfgcn.sim.world import MujocoWorld
from sdfgcn.task.region import Region

MAX_TRIES = 60  # positions tried before an object is left out
SLIDE = 0.002  # m, step size when placing an object against another


class ArrangementWorld:
    """One catalogue compiled into one world, for rendering many arrangements."""

    def __init__(
        self, env: EnvConfig, catalogue: Sequence[ObjectModel], arrangements: ArrangementsConfig
    ) -> None:
        """Compile a world of all objects of the catalogue."""
        self._arrangements, self._palette = arrangements, env.objects.palette
        physics = replace(env.physics, settle_seconds=arrangements.settle_seconds)
        self._world = MujocoWorld(replace(env, physics=physics), catalogue)
        self._appearance = Appearance(self._world.physics, env.arena, arrangements)
        spawn = Region.spawn(env.arena)
        self._region = Region(spawn.low - arrangements.margin, spawn.high + arrangements.margin)

    def pictures(
        self, rng: np.random.Generator
    ) -> Iterator[tuple[NDArray[np.uint8], NDArray[np.uint8]]]:
        """Draw one arrangement and render each of its looks.

        Yields:
            [H, W, 3] picture and its [H, W] labels: 0 for the table, 1 to n for objects.
        """
        world = self._world
        self._appearance.reset()
        world.begin(self._draw(rng))
        geoms = np.flatnonzero(world.task.slot_of_geom[:-1] >= 0)
        for _ in range(self._arrangements.appearances):
            plain = rng.random() < self._arrangements.plain
            if plain:
                self._appearance.reset()
                self._appearance.colour_from(rng, geoms, self._palette)
            else:
                self._appearance.draw(rng, geoms)
            labels = (world.task.slot_of_geom[world.renderer.geom_ids()] + 1).astype(np.uint8)
            pixels = world.renderer.pixels()
            if not plain:
                pixels = paint(rng, pixels, labels, self._arrangements.textured)
            yield pixels, labels

    def close(self) -> None:
        """Free the world."""
        self._world.close()

    def _draw(self, rng: np.random.Generator) -> EpisodeSpec:
        """An arrangement as an episode whose goal is its start."""
        kind = rng.random()
        stacked = kind < self._arrangements.stacked
        touching = kind < self._arrangements.stacked + self._arrangements.touching
        fewest, most = self._arrangements.n_objects
        n = int(rng.integers(fewest, most + 1))
        shapes: list[Polygon] = []
        poses: list[NDArray[np.float64]] = []
        kept: list[int] = []
        for index in rng.choice(len(self._world.catalogue), size=n, replace=False):
            model = self._world.catalogue[index]
            rest = draw_rest(rng, model)
            (quat,) = turned(rng, [rest])
            if stacked and poses and rng.random() < 0.5:
                poses.append(self._above(rng, rest, poses))
                kept.append(index)
                continue
            shape = footprint(model.vertices, quat)
            close = bool(touching and shapes and rng.random() < 0.7)
            point = self._place(rng, shape, shapes, close)
            if point is not None:
                shapes.append(translate(shape, *point))
                poses.append(np.hstack([point, rest.height, quat]))
                kept.append(index)
        start = np.stack(poses)
        white = np.ones((len(kept), 4))  # each look sets its own colours
        return EpisodeSpec(seed=0, objects=np.array(kept), start=start, goal=start, colors=white)

    def _above(
        self, rng: np.random.Generator, rest: Rest, poses: Sequence[NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """[7] a pose in the air above a random other object, randomly oriented."""
        below = poses[int(rng.integers(len(poses)))]
        point = below[:2] + rng.normal(0.0, 0.02, 2)
        height = below[2] + rest.radius + self._arrangements.drop_height
        return np.hstack([point, height, Rotation.random(rng=rng).as_quat(scalar_first=True)])

    def _place(
        self, rng: np.random.Generator, shape: Polygon, others: Sequence[Polygon], close: bool
    ) -> NDArray[np.float64] | None:
        """[2] a free position, metres, or None; with `close`, against another object."""
        for _ in range(MAX_TRIES):
            point = rng.uniform(self._region.low, self._region.high)
            if close:
                other = others[int(rng.integers(len(others)))]
                point = _slide(rng, shape, other)
            there = translate(shape, *point)
            free = all(there.distance(other) > 0.0 for other in others)
            if free and self._region.contains(point):
                return point
        return None


def _slide(rng: np.random.Generator, shape: Polygon, other: Polygon) -> NDArray[np.float64]:
    """[2] the position just touching `other` on a random side, metres."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    away = np.array([np.cos(angle), np.sin(angle)])
    center = np.array(other.centroid.coords[0]) + rng.normal(0.0, 0.01, 2)
    for distance in np.arange(0.0, 0.3, SLIDE):
        point = center + distance * away
        if translate(shape, *point).distance(other) > 0.0:
            return point
    return center + 0.3 * away
