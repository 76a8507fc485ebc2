"""Draw an episode: its objects, their colours, and their start and goal poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sdfgcn.config import EnvConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.model import ObjectModel, Rest
from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.placement import NoRoom, footprint
from sdfgcn.sim.scenarios.scenario import Scenario, Situation

MAX_DRAWS = 200  # draws of objects and layout before giving up


@dataclass(frozen=True)
class EpisodeSpec:
    """All random choices of an episode, drawn before it begins.

    Attributes:
        seed: The seed it was drawn from.
        objects: [n] indices into the catalogue, in slot order.
        start: [n, 7] poses: xyz in metres, quaternion w, x, y, z.
        goal: [n, 7] poses, in the same format.
        colors: [n, 4] RGBA; ignored by textured objects.
    """

    seed: int
    objects: NDArray[np.int64]
    start: NDArray[np.float64]
    goal: NDArray[np.float64]
    colors: NDArray[np.float64]


def draw_episode(
    seed: int, catalogue: Sequence[ObjectModel], config: EnvConfig, redraw: int = 0
) -> EpisodeSpec:
    """Draw an episode from its seed alone.

    Args:
        seed: Determines the episode.
        catalogue: The objects to draw from.
        config: The `env` part of the config.
        redraw: Which of the seed's episodes; 0 for the one that is used if all can be seen in it.

    Raises:
        SdfgcnError: There are too few objects for the scenario or the catalogue is too small, or
            no layout was found.
    """
    rng = np.random.default_rng([seed, redraw] if redraw else seed)
    scenario = SCENARIOS[config.scenario.name](config.scenario, config.arena)
    n = config.n_objects
    if n < scenario.least_objects:
        raise SdfgcnError(
            f"scenario={config.scenario.name} needs at least {scenario.least_objects} objects, "
            f"but n_objects is {n}."
        )
    if n > len(catalogue):
        raise SdfgcnError(
            f"n_objects is {n}, but objects={config.objects.name} has only {len(catalogue)} "
            f"objects in its {config.split} split."
        )
    for _ in range(MAX_DRAWS):
        chosen = _choose(rng, catalogue, n, scenario)
        rests = [draw_rest(rng, catalogue[i]) for i in chosen]
        start = turned(rng, rests)
        goal = start if scenario.same_yaw else turned(rng, rests)
        models = [catalogue[i] for i in chosen]
        situation = Situation(
            start=tuple(map(footprint, [m.hull for m in models], start)),
            goal=tuple(map(footprint, [m.hull for m in models], goal)),
            categories=tuple(m.category for m in models),
        )
        try:
            layout = scenario.draw(rng, situation)
        except NoRoom:
            continue
        heights = [[rest.height] for rest in rests]
        return EpisodeSpec(
            seed=seed,
            objects=chosen,
            start=np.hstack([layout.start, heights, start]),
            goal=np.hstack([layout.goal, heights, goal]),
            colors=_colors(rng, config.objects.palette, n),
        )
    raise SdfgcnError(
        f"No {config.scenario.name} layout of {n} objects was found in {MAX_DRAWS} draws; "
        f"use fewer objects, a smaller env.scenario.spacing (now {config.scenario.spacing} m) or "
        f"a larger spawn region (env.arena.spawn_x, env.arena.spawn_y)."
    )


def _choose(
    rng: np.random.Generator, catalogue: Sequence[ObjectModel], n: int, scenario: Scenario
) -> NDArray[np.int64]:
    """[n] distinct catalogue indices, from few categories if the scenario wants that."""
    if not scenario.same_category:
        return rng.choice(len(catalogue), size=n, replace=False)
    members: dict[str, list[int]] = {}
    for i in rng.permutation(len(catalogue)):
        members.setdefault(catalogue[i].category, []).append(int(i))
    # Categories with at least two objects first (otherwise in random order), to form groups.
    groups = sorted(members.values(), key=lambda group: len(group) < 2)
    groups = groups[: max(2, n // 2)] if n > 1 else groups[:1]
    spare = [i for group in members.values() if group not in groups for i in group]
    picked: list[int] = []
    while len(picked) < n:
        for group in [*groups, spare]:
            if len(picked) < n and group and (group is not spare or not any(groups)):
                picked.append(group.pop())
    return np.array(picked)


def draw_rest(rng: np.random.Generator, model: ObjectModel) -> Rest:
    """Draw one of the object's resting poses by their probabilities."""
    share = np.array([rest.probability for rest in model.rests])
    return model.rests[rng.choice(len(model.rests), p=share / share.sum())]


def turned(rng: np.random.Generator, rests: Sequence[Rest]) -> NDArray:
    """[n, 4] the rests' orientations (w, x, y, z), each with a random yaw."""
    turns = Rotation.from_euler("z", rng.uniform(0.0, 2.0 * np.pi, size=(len(rests), 1)))
    tilts = Rotation.from_quat([rest.quat for rest in rests], scalar_first=True)
    return (turns * tilts).as_quat(scalar_first=True)


def _colors(rng: np.random.Generator, palette: Sequence[Sequence[float]], n: int) -> NDArray:
    """[n, 4] RGBA palette colours, repeated only once the palette is exhausted."""
    order = np.concatenate(
        [rng.permutation(len(palette)) for _ in range(int(np.ceil(n / len(palette))))]
    )[:n]
    return np.hstack([np.asarray(palette, dtype=np.float64)[order, :3], np.ones((n, 1))])
