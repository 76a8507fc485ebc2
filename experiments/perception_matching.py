"""The matching section of `perception.py`: is each object matched with itself in the goal picture?

Uses held-out objects, true masks and the env's own pictures. Each object is turned and moved at
random. Untextured objects draw their colours from one palette with replacement, so two may have the
same. Writes `perception_matching.json`, the same as a table in `.md`, and in `.png` some
scenes with the most objects and the failures, start and goal side by side: both ends of a match are
outlined in one colour, and framed in red if it is wrong. Other objects, splits and encoders get
their own files (`perception_matching_household`). An interrupted run resumes with the next number
of objects.
"""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from common import file_name, load, save
from numpy.typing import NDArray
from pictures import Picture, outlined, save_png, sheet, titled
from tqdm import tqdm

from sdfgcn.config import Config, EnvConfig
from sdfgcn.evaluation.report import percent
from sdfgcn.evaluation.results import wilson
from sdfgcn.files import write_json, write_text
from sdfgcn.perception.base import detected
from sdfgcn.perception.matching import Matcher
from sdfgcn.provenance import provenance
from sdfgcn.sim.episode import draw_episode
from sdfgcn.sim.world import MujocoWorld

SCENES = 500  # of each number of objects
N_OBJECTS = (2, 3, 4, 5, 6)
USUAL = {"scanned", "test", "efficientnet_lite0"}
KINDS = {
    "matcher": "wholly right",
    "encoder_alone": "without mean colour",
    "color_alone": "by mean colour alone",
    "size_alone": "by size alone",
}
SHOWN = 8  # correct scenes in the figure, and at most as many failures

Row = dict[str, Any]


@dataclass(frozen=True)
class View:
    """One picture and its true masks.

    Attributes:
        pixels: uint8 [H, W, 3].
        masks: bool [m, H, W].
    """

    pixels: Picture
    masks: NDArray[np.bool_]


@dataclass(frozen=True)
class Scene:
    """Start and goal of one episode, with the masks large enough to be detected.

    Attributes:
        current: The start's picture.
        goal: The goal's picture.
        expected: int64 [m] index of each current object's goal mask, -1 for none.
    """

    current: View
    goal: View
    expected: NDArray[np.int64]


def run(overrides: list[str], scenes: int, folder: Path) -> None:
    """Match `scenes` scenes of each number of objects; write the results after each number."""
    if not any(override.startswith("robot=") for override in overrides):
        overrides = [*overrides, "robot=gripper"]  # not in the picture, and faster to build
    config = load([*overrides, "perception=oracle"])
    matcher = Matcher(config.env.perception.encoder)
    head, name = header(config, scenes, overrides), result_name(config)
    rows = finished(folder, name, head)
    with closing(Scenes(config.env, config.seed)) as drawn:
        for n in tqdm(N_OBJECTS[len(rows) :], unit="count"):
            rows.append(measure(drawn, matcher, n, scenes))
            write_json(folder / f"{name}.json", {**head, "rows": rows})
            share = rows[-1]["matcher"]["scenes_right"]
            tqdm.write(f"{n} objects: {percent(share, digits=1)} of the scenes wholly right")
        save(folder, name, {**head, "rows": rows})
        write_text(folder / f"{name}.md", markdown(rows))
        save_png(folder / f"{name}.png", figure(drawn, matcher, rows))


class Scenes:
    """Draws scenes that depend only on the seed, their number of objects and their index."""

    def __init__(self, config: EnvConfig, seed: int) -> None:
        """Compile the world."""
        self._config, self._seed = config, seed
        self._world = MujocoWorld(config)

    def draw(self, n: int, index: int) -> Scene:
        """Scene number `index` with n objects; goal masks shuffled."""
        world, config = self._world, replace(self._config, n_objects=n)
        rng = np.random.default_rng([self._seed, n, index])
        drawn = draw_episode(int(rng.integers(2**31)), world.catalogue, config)
        palette = np.asarray(config.objects.palette)
        colors = np.ones_like(drawn.colors)
        colors[:, :3] = palette[rng.integers(len(palette), size=n)]
        world.begin(replace(drawn, colors=colors))
        world.task.set_poses(world.physics, drawn.start)  # as drawn, not as settled
        views = (
            View(view.pixels(), view.true_masks()) for view in (world.look(), world.look_at_goal())
        )
        return shuffled(*views, rng.permutation(n), config)

    def close(self) -> None:
        """Free the world."""
        self._world.close()


def shuffled(current: View, goal: View, order: NDArray, config: EnvConfig) -> Scene:
    """Keep the detected objects, and reorder those of the goal by `order`."""
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
    """[m] whether each object is matched with itself; one missing in the goal is always right."""
    return (found == expected) | (expected < 0)


def measure(scenes: Scenes, matcher: Matcher, n: int, count: int) -> Row:
    """Match `count` scenes of n objects, by the whole feature and by its parts.

    Returns:
        For each kind of feature, the share of scenes wholly right and of objects right; the
        wrong scenes; and the CPU time per object, milliseconds.
    """
    scene_right: dict[str, list[bool]] = {kind: [] for kind in KINDS}
    object_right: dict[str, list[bool]] = {kind: [] for kind in KINDS}
    seconds: list[float] = []
    for index in tqdm(range(count), unit="scene", desc=f"{n} objects", leave=False):
        each = scenes.draw(n, index)
        views = (each.current, each.goal)
        began = time.process_time()
        whole = [matcher.features(view.pixels, view.masks) for view in views]
        seconds.append((time.process_time() - began) / max(1, sum(len(v.masks) for v in views)))
        features = {
            "matcher": whole,
            "encoder_alone": [rows[:, :-3] for rows in whole],
            "color_alone": [mean_color(view) for view in views],
            "size_alone": [size(view) for view in views],
        }
        for kind, (rows, goal_rows) in features.items():
            verdict = right(matcher.match(rows, goal_rows), each.expected)
            scene_right[kind].append(bool(verdict.all()))
            object_right[kind].extend(verdict.tolist())
    return {
        "n_objects": n,
        "scenes": count,
        **{
            kind: {
                "scenes_right": float(np.mean(verdicts)),
                "scenes_right_ci95": wilson(sum(verdicts), count),
                "objects_right": float(np.mean(object_right[kind])),
            }
            for kind, verdicts in scene_right.items()
        },
        "wrong_scenes": np.flatnonzero(~np.array(scene_right["matcher"])).tolist(),
        "cpu_ms_an_object": {
            "median": float(1e3 * np.median(seconds)),
            "p95": float(1e3 * np.quantile(seconds, 0.95)),
        },
    }


def header(config: Config, scenes: int, overrides: list[str]) -> dict[str, Any]:
    """The settings behind the rows; scene i of n objects is drawn from [seed, n, i]."""
    return {
        "objects": config.env.objects.name,
        "split": config.env.split,
        "encoder": asdict(config.env.perception.encoder),
        "overrides": overrides,
        "seed": config.seed,
        "scenes": scenes,
        **provenance(),
    }


def result_name(config: Config) -> str:
    """The result's file name, distinct for every object source, split and encoder."""
    env = config.env
    parts = (env.objects.name, env.split, env.perception.encoder.name)
    return file_name("perception_matching", parts, USUAL)


def finished(folder: Path, name: str, head: dict[str, Any]) -> list[Row]:
    """Rows already written by an interrupted run of the same commit and config."""
    path = folder / f"{name}.json"
    if not path.exists():
        return []
    written = json.loads(path.read_text(encoding="utf-8"))
    same = all(written.get(key) == value for key, value in head.items() if key != "git")
    commit = (written.get("git") or {}).get("commit")
    if not same or commit != (head["git"] or {}).get("commit"):
        return []
    tqdm.write(f"goes on from {path}; remove it to begin again")
    return written["rows"]


def markdown(rows: Sequence[Row]) -> str:
    """The shares of scenes as a Markdown table, with Wilson's 95% intervals in brackets."""
    lines = [
        f"| n objects | scenes | {' | '.join(KINDS.values())} | objects right |",
        f"|{' --- |' * (len(KINDS) + 3)}",
    ]
    for row in rows:
        shares = (
            percent(row[kind]["scenes_right"], row[kind]["scenes_right_ci95"], 1) for kind in KINDS
        )
        objects = percent(row["matcher"]["objects_right"], digits=1)
        lines.append(f"| {row['n_objects']} | {row['scenes']} | {' | '.join(shares)} | {objects} |")
    return "\n".join(lines) + "\n"


def examples(rows: Sequence[Row]) -> list[tuple[int, int]]:
    """(n objects, index) of the first correct scenes with the most objects, then of failures."""
    most = rows[-1]
    rights = [k for k in range(most["scenes"]) if k not in most["wrong_scenes"]]
    failures = [(row["n_objects"], k) for row in reversed(rows) for k in row["wrong_scenes"]]
    return [*((most["n_objects"], k) for k in rights[:SHOWN]), *failures[:SHOWN]]


def figure(scenes: Scenes, matcher: Matcher, rows: Sequence[Row]) -> Picture:
    """The examples, start and goal side by side, four in a row."""
    tiles = []
    for n, index in examples(rows):
        each = scenes.draw(n, index)
        views = (each.current, each.goal)
        found = matcher.match(*(matcher.features(view.pixels, view.masks) for view in views))
        verdict = right(found, each.expected)
        title = f"{n} objects, scene {index}: {verdict.sum()} of {len(verdict)} right"
        tiles.append(titled(pair(each, found, verdict), title))
    return sheet(tiles, columns=4, gap=8)


def pair(
    each: Scene, found: NDArray[np.int64], verdict: NDArray[np.bool_], scale: int = 3
) -> Picture:
    """Start and goal side by side, with the matches found."""
    goal_matches = np.full(len(each.goal.masks), -1)
    goal_wrong = np.zeros(len(each.goal.masks), dtype=bool)
    matched = found >= 0
    goal_matches[found[matched]] = found[matched]
    goal_wrong[found[matched]] = ~verdict[matched]
    start = outlined(each.current.pixels, each.current.masks, found, ~verdict, scale)
    goal = outlined(each.goal.pixels, each.goal.masks, goal_matches, goal_wrong, scale)
    return np.hstack([start, goal])
