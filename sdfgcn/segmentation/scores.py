"""Scores of a segmenter on the environment's own scenes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from sdfgcn.config import EnvConfig
from sdfgcn.objects.model import ObjectModel
from sdfgcn.perception.base import detected
from sdfgcn.segmentation.metrics import MaskScores, score_masks
from sdfgcn.sim.world import MujocoWorld


@dataclass(frozen=True)
class Example:
    """The start of an episode as seen by the camera.

    Attributes:
        seed: Seed of the episode.
        pixels: [H, W, 3] RGB.
        masks: [n, H, W] true masks of the detectable objects.
        n_objects: Objects on the table, detectable or not.
    """

    seed: int
    pixels: NDArray[np.uint8]
    masks: NDArray[np.bool_]
    n_objects: int


Relight = Callable[[mjcf.Physics, np.random.Generator], None]


def views(
    env: EnvConfig,
    catalogue: Sequence[ObjectModel],
    n_objects: Sequence[int],
    scenes: int,
    relight: Relight | None = None,
) -> Iterator[Example]:
    """Render the start of episodes 0 to `scenes` - 1 for each number of objects.

    Args:
        env: The environment; its split and number of objects are ignored.
        catalogue: The objects to draw from.
        n_objects: Numbers of objects.
        scenes: Scenes per number of objects.
        relight: Changes the look of the compiled model before each picture, given the physics and
            a generator seeded by the episode.
    """
    with closing(MujocoWorld(env, catalogue)) as world:
        for n in n_objects:
            for seed in range(scenes):
                world.reset(seed, n)
                if relight is not None:
                    relight(world.physics, np.random.default_rng([seed, n]))
                view = world.look()
                masks = view.true_masks()
                seen = detected(masks, env.perception.min_pixels)
                yield Example(seed, view.pixels(), masks[seen], n)


def shifted_look(physics: mjcf.Physics, rng: np.random.Generator) -> None:
    """Randomise the light and the table colour; for `views`."""
    model = physics.model
    lamp, table = model.name2id("lamp", "light"), model.name2id("table", "geom")
    place = np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(1.0, 2.0)])
    model.light_pos[lamp] = place
    model.light_dir[lamp] = -place / np.linalg.norm(place)
    model.light_diffuse[lamp] = rng.uniform(0.3, 0.9)
    model.vis.headlight.ambient[:] = rng.uniform(0.2, 0.5)
    model.vis.headlight.diffuse[:] = rng.uniform(0.1, 0.5)
    model.geom_rgba[table, :3] = rng.uniform(0.1, 0.9, 3)
    mujoco.mj_camlight(model.ptr, physics.data.ptr)


def score(
    segment: Callable[[NDArray[np.uint8]], NDArray[np.bool_]], scenes: Iterable[Example]
) -> list[tuple[Example, NDArray[np.bool_], MaskScores]]:
    """Segment every scene; return each with the masks found and their scores."""
    rows = []
    for scene in scenes:
        masks = segment(scene.pixels)
        rows.append((scene, masks, score_masks(masks, scene.masks)))
    return rows


def summary(scores: Sequence[MaskScores]) -> dict[str, float]:
    """Means over pictures, as shares from 0 to 1."""
    figures: dict[str, list[float]] = {
        "overlap_f": [s.overlap.f for s in scores],
        "overlap_precision": [s.overlap.precision for s in scores],
        "overlap_recall": [s.overlap.recall for s in scores],
        "boundary_f": [s.boundary.f for s in scores],
        "count_right": [s.found == s.true for s in scores],
    }
    return {name: float(np.mean(values)) for name, values in figures.items()}
