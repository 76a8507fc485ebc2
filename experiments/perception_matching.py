"""How often every object of a scene is matched with itself in the goal picture.

    python experiments/perception_matching.py                   500 scenes of 2 to 6 objects
    python experiments/perception_matching.py scenes=50 objects=household

Held-out objects, true masks, the env's own pictures. Each object is turned and moved at random.
Objects without a texture draw their colours from one palette with replacement, so that two may
have the same. Writes `results/perception_matching.json`, or `_household` and so on;
a run that was cut off goes on with the next count.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import numpy as np
import torch
from common import RESULTS, ROOT, load, parse, save
from numpy.typing import NDArray
from tqdm import tqdm

from sdfgcn.config import Config, EnvConfig
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.envs.types import Scene as Picture
from sdfgcn.files import write_json
from sdfgcn.perception.matching import Matcher
from sdfgcn.perception.perception import detected
from sdfgcn.results import git_state, versions, wilson
from sdfgcn.sim.episode import draw_episode

N_OBJECTS = (2, 3, 4, 5, 6)


@dataclass(frozen=True)
class View:
    """One picture and its true masks.

    Attributes:
        pixels: uint8 [H, W, 3].
        masks: bool [m, H, W], every one large enough to be detected.
    """

    pixels: NDArray[np.uint8]
    masks: NDArray[np.bool_]


@dataclass(frozen=True)
class Scene:
    """Start and goal of one episode.

    Attributes:
        current: The start's picture.
        goal: The goal's picture.
        expected: int64 [m] for each current mask the goal mask of the same object, -1 for none.
    """

    current: View
    goal: View
    expected: NDArray[np.int64]


def scenes(env: RearrangementEnv, count: int, seed: int) -> Iterator[Scene]:
    """Pictures of `count` episodes whose seeds follow from `seed`; goal masks in random order."""
    env.record = True
    palette = np.asarray(env.config.objects.palette)
    rng = np.random.default_rng(seed)
    for _ in range(count):
        drawn = draw_episode(int(rng.integers(2**31)), env.catalogue, env.config)
        colors = np.ones_like(drawn.colors)
        colors[:, :3] = palette[rng.integers(len(palette), size=len(colors))]
        episode = replace(drawn, colors=colors)
        state = rng.bit_generator.state  # what the env would draw later episodes with
        env.restore_state({"episode": episode, "poses": drawn.start, "pushes": 0, "rng": state})
        start = env.episode_start
        yield scene(start.scene, start.goal, rng.permutation(len(colors)), env.config)


def scene(current: Picture, goal: Picture, order: NDArray, config: EnvConfig) -> Scene:
    """Keep what is detected, and shuffle the goal's objects."""
    least = config.perception.min_pixels
    slots = np.flatnonzero(detected(current.masks, least))
    goal_slots = order[detected(goal.masks, least)[order]]
    same = slots[:, None] == goal_slots
    return Scene(
        current=View(current.pixels, current.masks[slots]),
        goal=View(goal.pixels, goal.masks[goal_slots]),
        expected=np.where(same.any(axis=1), same.argmax(axis=1), -1),
    )


def mean_color(view: View) -> NDArray[np.float64]:
    """[m, 3] the mean colour of each object, 0 to 1."""
    return np.array([view.pixels[mask].mean(axis=0) / 255.0 for mask in view.masks])


def size(view: View) -> NDArray[np.float64]:
    """[m, 1] the square root of each object's area, pixels."""
    return np.sqrt(view.masks.sum(axis=(1, 2)))[:, None]


def right(found: NDArray[np.int64], expected: NDArray[np.int64]) -> NDArray[np.bool_]:
    """[m] whether each object went to itself; one that the goal does not show may go anywhere."""
    return (found == expected) | (expected < 0)


def measure(config: EnvConfig, matcher: Matcher, count: int, seed: int) -> dict[str, Any]:
    """Match `count` scenes, by the whole feature and by its parts.

    Returns:
        For each kind of feature the share of scenes that are wholly right, and of objects; and
        the milliseconds of processor time that a new object costs.
    """
    env = RearrangementEnv(config, seed=seed)
    scene_right: dict[str, list[bool]] = {}
    object_right: dict[str, list[bool]] = {}
    seconds: list[float] = []
    for each in tqdm(scenes(env, count, seed), total=count, unit="scene", leave=False):
        views = (each.current, each.goal)
        began = time.process_time()
        whole = [matcher.features(view.pixels, view.masks) for view in views]
        seconds.append((time.process_time() - began) / max(1, sum(len(v.masks) for v in views)))
        kinds = {
            "matcher": whole,
            "encoder_alone": [rows[:, :-3] for rows in whole],
            "color_alone": [mean_color(view) for view in views],
            "size_alone": [size(view) for view in views],
        }
        for kind, (rows, goal_rows) in kinds.items():
            verdict = right(matcher.match(rows, goal_rows), each.expected)
            scene_right.setdefault(kind, []).append(bool(verdict.all()))
            object_right.setdefault(kind, []).extend(verdict.tolist())
    env.close()
    return {
        "n_objects": config.n_objects,
        "scenes": count,
        **{
            kind: {
                "scenes_right": float(np.mean(verdicts)),
                "scenes_right_ci95": wilson(sum(verdicts), count),
                "objects_right": float(np.mean(object_right[kind])),
            }
            for kind, verdicts in scene_right.items()
        },
        "cpu_ms_an_object": {
            "median": float(1e3 * np.median(seconds)),
            "p95": float(1e3 * np.quantile(seconds, 0.95)),
        },
    }


def header(config: Config, scenes_each: int, overrides: list[str]) -> dict[str, Any]:
    """What the rows follow from."""
    return {
        "objects": config.env.objects.name,
        "split": config.env.split,
        "encoder": asdict(config.env.perception.encoder),
        "overrides": overrides,
        "seed": config.seed,
        "scenes": scenes_each,
        "versions": versions(),
        "git": git_state(ROOT),
    }


def file_name(config: Config) -> str:
    """The default's result, and each other one, under a name of its own."""
    usual = {"scanned", "test", "efficientnet_lite0"}
    parts = (config.env.objects.name, config.env.split, config.env.perception.encoder.name)
    return "_".join(["perception_matching", *(part for part in parts if part not in usual)])


def finished(name: str, head: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows that a run of the same code and config has already written: it was cut off."""
    path = RESULTS / f"{name}.json"
    if not path.exists():
        return []
    written = json.loads(path.read_text(encoding="utf-8"))
    same = all(written.get(key) == value for key, value in head.items() if key != "git")
    commit = (written.get("git") or {}).get("commit")
    if not same or commit != (head["git"] or {}).get("commit"):
        return []
    tqdm.write(f"goes on from {path}; remove it to begin again")
    return written["rows"]


def main() -> None:
    own, overrides = parse(sys.argv[1:], {"scenes": 500})
    if not any(override.startswith("robot=") for override in overrides):
        overrides.append("robot=gripper")  # out of the picture either way, and faster to build
    torch.set_num_threads(1)
    configs = {n: load([*overrides, f"n_objects={n}"]) for n in N_OBJECTS}
    config = configs[N_OBJECTS[0]]
    matcher = Matcher(config.env.perception.encoder)
    head, name = header(config, own["scenes"], overrides), file_name(config)
    rows = finished(name, head)
    for n in tqdm(N_OBJECTS[len(rows) :], unit="count"):
        rows.append(measure(configs[n].env, matcher, own["scenes"], seed=config.seed + n))
        write_json(RESULTS / f"{name}.json", {**head, "rows": rows})
        share = rows[-1]["matcher"]["scenes_right"]
        tqdm.write(f"{n} objects: {100 * share:.1f}% of the scenes wholly right")
    save(name, {**head, "rows": rows})


if __name__ == "__main__":
    main()
