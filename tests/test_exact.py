"""What must be the same on every machine, against values committed in `exact.json`.

Hashes are of what is computed without the simulator and without a renderer: episodes drawn from a
catalogue that is written down here, and SDFs of masks drawn by a formula. Values are rounded to a
millionth first, since the last digits of sine and cosine depend on the C library; that a value
lies within such a difference of a rounding edge has a chance of about one in a billion.

Resting poses come out of a simulation and pictures out of OpenGL: there, no rounding makes hashes
agree for certain, as some value always lies near an edge. Their numbers are stored themselves and
compared within a tolerance: heights and masses of prepared objects, and pictures of two scenes as
means over blocks of 8 x 8 pixels.

`python tests/test_exact.py` writes the file anew; do that only when a change is meant to change
results. The file was written on one machine (x86-64, Mesa's software OpenGL); that others agree
has not been tried.
"""

from __future__ import annotations

import hashlib
import json
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from configs import real_config
from conftest import Envs
from toys import IDENTITY, ON_ITS_SIDE, box_points, can_points, toy

from sdfgcn.config import EnvConfig
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.objects.model import ObjectModel
from sdfgcn.perception.sdf import SDF_METHODS
from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.episode import draw_episode

FILE = Path(__file__).parent / "exact.json"
DIGITS = 6  # of what is hashed
SEEDS = range(8)
SCENES = (11, 12)  # seeds of the two pictures
BLOCK = 8  # pixels, side of the blocks of a picture
LEVELS = 3.0  # of 255, by which the means of two renderers may differ
CELLS = 0.02  # share of the blocks that may differ more: edges of objects
METRES, SHARE = 5e-4, 1e-3  # by which heights, and relatively masses, may differ


def digest(*values: Any) -> str:
    """A hash of numbers, rounded, and text."""
    parts = []
    for value in values:
        if isinstance(value, str):
            parts.append(value.encode())
        else:  # + 0.0 turns -0.0 into 0.0
            parts.append((np.round(np.asarray(value, np.float64), DIGITS) + 0.0).tobytes())
    return hashlib.sha256(b"|".join(parts)).hexdigest()[:16]


def shelf() -> tuple[ObjectModel, ...]:
    """Eight bodies in four categories, whose sizes are written down here."""
    boxes = [toy(f"box_{k}", box_points(0.04 + 0.01 * k, 0.05, 0.03)) for k in range(4)]
    cans = [toy(f"can_{k}", can_points(0.02 + 0.004 * k, 0.06), ON_ITS_SIDE) for k in range(4)]
    rest = boxes[0].rests[0]
    sides = (replace(rest, probability=0.7), replace(rest, quat=ON_ITS_SIDE, probability=0.3))
    boxes[0] = replace(boxes[0], rests=sides)
    return tuple(
        replace(body, category=f"category_{k // 2}") for k, body in enumerate([*boxes, *cans])
    )


def episodes(scenario: str) -> str:
    """The hash of a scenario's episodes: names, start, goal and colours."""
    config: EnvConfig = real_config("objects=household", f"scenario={scenario}").env
    bodies = shelf()
    found: list[Any] = []
    for seed in SEEDS:
        n = max(SCENARIOS[scenario].least_objects, 2 + seed % 5)
        episode = draw_episode(seed, bodies, replace(config, n_objects=n))
        found += [";".join(bodies[i].name for i in episode.objects)]
        found += [episode.start, episode.goal, episode.colors]
    return digest(*found)


def fields(method: str) -> str:
    """The hash of the SDFs of a disc, a bar and two parts."""
    rows, columns = np.mgrid[:96, :96]
    disc = (rows - 40) ** 2 + (columns - 60) ** 2 < 15**2
    bar = np.abs(rows + 2 * columns - 150) < 12
    parts = (rows < 5) | ((rows > 70) & (columns > 80))
    return digest(*(SDF_METHODS[method](mask) for mask in (disc, bar, parts)))


def objects() -> dict[str, Any]:
    """Heights (m), of every resting pose, and masses (kg) of the generated test objects."""
    models = load_catalogue(real_config("objects=household").env.objects, "test")
    return {
        model.name: {
            "mass": model.mass,
            "heights": [rest.height for rest in model.rests],
            "probabilities": [rest.probability for rest in model.rests],
        }
        for model in models
    }


def picture(env: RearrangementEnv, seed: int) -> list[int]:
    """Means of red, green and blue over the blocks of a picture, row by row."""
    env.reset_episode(seed)
    pixels = env.world.look().pixels().astype(float)
    size = len(pixels) // BLOCK
    blocks = pixels.reshape(size, BLOCK, size, BLOCK, 3).mean(axis=(1, 3))
    return np.rint(blocks).astype(int).ravel().tolist()


def everything(env: RearrangementEnv) -> dict[str, Any]:
    """The content of `exact.json`."""
    return {
        "episodes": {name: episodes(name) for name in SCENARIOS},
        "sdfs": {name: fields(name) for name in SDF_METHODS},
        "objects": objects(),
        "pictures": {str(seed): picture(env, seed) for seed in SCENES},
    }


STORED = json.loads(FILE.read_text()) if FILE.exists() else {}


@pytest.mark.parametrize("scenario", sorted(SCENARIOS))
def test_episodes_are_drawn_as_ever(scenario: str) -> None:
    assert episodes(scenario) == STORED["episodes"][scenario]


@pytest.mark.parametrize("method", SDF_METHODS)
def test_sdfs_are_as_ever(method: str) -> None:
    assert fields(method) == STORED["sdfs"][method]


def test_prepared_objects_are_as_ever() -> None:
    found = objects()
    assert list(found) == list(STORED["objects"])
    for name, stored in STORED["objects"].items():
        assert found[name]["mass"] == pytest.approx(stored["mass"], rel=SHARE), name
        assert found[name]["heights"] == pytest.approx(stored["heights"], abs=METRES), name
        assert found[name]["probabilities"] == pytest.approx(stored["probabilities"]), name


@pytest.mark.parametrize("seed", SCENES)
def test_pictures_are_as_ever(seed: int, env_of: Envs) -> None:
    env = env_of("robot=gripper")
    env.n_objects = 3
    difference = np.abs(np.subtract(picture(env, seed), STORED["pictures"][str(seed)]))
    assert np.mean(difference > LEVELS) <= CELLS


def test_hashes_notice_a_change_and_no_rounding() -> None:
    values = [0.123456789, -0.0]
    assert digest(values) == digest([0.123456789 + 1e-12, 0.0])
    assert digest(values) != digest([0.123456789 + 1e-5, 0.0])
    assert digest("a", values) != digest("b", values)


def test_bodies_do_not_depend_on_a_simulation() -> None:
    assert [rest.quat for rest in shelf()[0].rests] == [IDENTITY, ON_ITS_SIDE]


if __name__ == "__main__":
    config = real_config("objects=household", "robot=gripper").env
    with closing(RearrangementEnv(config, seed=0)) as made:
        made.n_objects = 3
        FILE.write_text(json.dumps(everything(made), indent=None, separators=(",", ":")) + "\n")
    print(f"Wrote {FILE}.", file=sys.stderr)
