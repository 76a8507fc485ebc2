"""The range beside every number of the config: that it is there, is checked, and can be read."""

import copy
import math
import random
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest
from configs import compose_config, real_config
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig, OmegaConf

from sdfgcn import compose
from sdfgcn.cli import to_sentence
from sdfgcn.config import (
    Config,
    SegmentationTrainingConfig,
    check_ranges,
    colour,
    colours,
    fraction,
    interval,
    matching,
    number,
    one_of,
    positive,
    range_text,
    rising,
    several,
    vector,
)
from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.sdf import SDF_METHODS
from sdfgcn.registry import REGISTRIES
from sdfgcn.validation import (
    typed,
    typed_segmentation_training,
    validate,
    validate_segmentation_training,
)

RUN = Path(__file__).parents[1] / "run.py"

# ------------------------------------------------------------------ every number has one


def has_numbers(hint: Any) -> bool:
    """Whether a type is a number, or a list, dictionary or union with one."""
    return hint in (int, float) or any(map(has_numbers, get_args(hint)))


def config_types() -> set[type]:
    """Every dataclass that a config may hold."""
    found: set[type] = set()
    waiting: list[Any] = [Config, SegmentationTrainingConfig]
    for registry in REGISTRIES:
        waiting += [registry.base, *map(registry.config_type, registry)]
    while waiting:
        hint = waiting.pop()
        waiting += get_args(hint)
        if is_dataclass(hint) and hint not in found:
            found.add(hint)
            waiting += get_type_hints(hint).values()
    return found


CONFIG_TYPES = sorted(config_types(), key=lambda each: each.__name__)


@pytest.mark.parametrize("config_type", CONFIG_TYPES, ids=lambda each: each.__name__)
def test_every_number_has_a_range(config_type: type) -> None:
    hints = get_type_hints(config_type)
    for each in fields(config_type):
        if has_numbers(hints[each.name]):
            assert "range" in each.metadata, f"{config_type.__name__}.{each.name} has no range"
            assert range_text(each)


def test_the_walk_finds_what_it_should() -> None:
    names = {each.__name__ for each in CONFIG_TYPES}
    assert {"ArenaConfig", "UCNConfig", "GripperConfig", "PlannerConfig", "MethodConfig"} <= names
    assert {"ConvWidthConfig", "ArrangementsConfig", "ReleasedConfig"} <= names
    assert has_numbers(list[list[int]])
    assert has_numbers(float | None)
    assert not has_numbers(dict[str, bool])


def test_the_sdf_methods_are_those_of_the_code() -> None:
    choices = next(f for f in fields(type(real_config().env.perception)) if f.name == "sdf")
    assert range_text(choices) == f"one of {', '.join(SDF_METHODS)}"


# ------------------------------------------------------------------ ranges by hand


@dataclass
class Example:
    """A field of each kind."""

    above: float = positive(default=1.0)
    scale: float | None = positive(10, default=1.0)
    share: float = fraction(default=0.5)
    angle: float = number(0, below=90, default=30.0)
    count: int = number(1, 100, default=2)
    any: float = number(default=-3.0)
    kind: str = one_of("edt", "fmm", default="fmm")
    device: str = matching("cpu|cuda", "cpu or cuda")
    region: list[float] = interval(-2, 2)
    counts: list[int] = rising(1, 8, default=[2, 3])
    point: list[float] = vector(2)
    table: list[float] = colour(4)
    palette: list[list[float]] = colours()
    widths: list[list[int]] = several(1, 64)
    free: str = "text"
    more: list[str] = field(default_factory=list)


EXAMPLE = Example(
    device="cuda",
    region=[-0.1, 0.2],
    point=[0.0, 9.0],
    table=[0.0, 0.5, 1.0, 1.0],
    palette=[[0.0, 0.5, 1.0]],
    widths=[[1, 64], [2]],
)
TEXTS = {
    "above": "> 0",
    "scale": "> 0, <= 10, or null",
    "share": "0 to 1",
    "angle": ">= 0, < 90",
    "count": "1 to 100",
    "any": "finite",
    "kind": "one of edt, fmm",
    "device": "cpu or cuda",
    "region": "[low, high] with low < high, each -2 to 2",
    "counts": "rising, each 1 to 8",
    "point": "2 numbers, each finite",
    "table": "4 numbers, each 0 to 1",
    "palette": "one or more lists of 3 numbers, each 0 to 1",
    "widths": "one or more, each 1 to 64",
    "free": "",
    "more": "",
}


def test_ranges_as_text() -> None:
    assert {each.name: range_text(each) for each in fields(Example)} == TEXTS


BAD: dict[str, tuple[list[Any], str]] = {
    "above": ([0.0, -1.0], "must be above 0."),
    "scale": ([0.0, 10.1], "must be above 0 and at most 10."),
    "share": ([-0.1, 1.1], "must lie between 0 and 1."),
    "angle": ([-1.0, 90.0], "must be at least 0 and below 90."),
    "count": ([0, 101], "must lie between 1 and 100."),
    "any": ([], "must be finite."),
    "kind": (["l7", ""], "must be one of edt, fmm."),
    "device": (["tpu", "cpu0", ""], "must be cpu or cuda."),
    "region": (
        [[0.2, -0.1], [0.1, 0.1], [0.1], [], [0.0, 1.0, 2.0], [-3.0, 0.0], [0.0, 2.1]],
        "must be two numbers between -2 and 2, the first below the second.",
    ),
    "counts": (
        [[4, 2], [2, 2], [0, 1], [7, 9]],
        "must list numbers between 1 and 8, each above the one before.",
    ),
    "point": ([[1.0], [1.0, 2.0, 3.0], []], "must be 2 numbers."),
    "table": ([[1.0, 1.0], [0.0, 0.0, 0.0, 1.1]], "must be 4 numbers between 0 and 1."),
    "palette": ([[], [[0.1, 0.1]], [[0.1, 0.1, 2.0]]], "must list colours of three numbers"),
    "widths": ([[], [[]], [[0]], [[1], [65]]], "must list one or more numbers between 1 and 64."),
}


def filled(value: Any, number: float) -> Any:
    return [filled(item, number) for item in value] if isinstance(value, list) else number


def told_of(config: Any, key: str, value: Any) -> str:
    """What is said of a config in which one key has another value; empty if nothing."""
    path, owner, name = owner_of(config, key)
    try:
        check_ranges(replace(owner, **{name: value}), path)
    except SdfgcnError as error:
        return str(error)
    return ""


def owner_of(config: Any, key: str) -> tuple[str, Any, str]:
    """The path of the dataclass that has a key, that dataclass, and the key's name in it."""
    path, _, name = key.rpartition(".")
    return path, attrgetter(path)(config) if path else config, name


@pytest.mark.parametrize("key", BAD)
def test_values_beyond_a_range_are_told(key: str) -> None:
    values, words = BAD[key]
    value = getattr(EXAMPLE, key)
    assert told_of(EXAMPLE, key, value) == ""
    if not isinstance(value, str):
        values = [*values, *(filled(value, odd) for odd in (math.nan, math.inf, -math.inf))]
    for bad in values:
        told = told_of(EXAMPLE, key, bad)
        assert told.startswith(f"{key} is "), (key, bad)
        assert words in told or "must be finite" in told, (key, bad)


def test_null_and_numbers_without_a_range() -> None:
    assert told_of(EXAMPLE, "scale", None) == ""
    assert told_of(EXAMPLE, "more", [math.nan]) == "more is [nan], but every number must be finite."


# ------------------------------------------------------------------ every key of the real config

COMPONENTS = (
    ("model=sdfgcn", "curriculum=on", "perception=vision", "robot=gripper"),
    ("model=pose_gcn", "robot=ur5e", "encoder=resnet", "objects=shapenet"),
    ("model=push_model", "her=future", "env=table", "objects=household"),
)


def leaves(config: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every key below a config with its value; a list is one value."""
    for each in fields(config):
        value, key = getattr(config, each.name), f"{path}.{each.name}".removeprefix(".")
        if is_dataclass(value):
            yield from leaves(value, key)
        elif not isinstance(value, dict):
            yield key, value


def is_numeric(value: Any) -> bool:
    while isinstance(value, list) and value:
        value = value[0]
    return isinstance(value, int | float) and not isinstance(value, bool)


@pytest.mark.parametrize("overrides", COMPONENTS)
def test_every_number_is_finite_and_in_its_range(overrides: tuple[str, ...]) -> None:
    config = real_config(*overrides)
    keys = [key for key, value in leaves(config) if is_numeric(value)]
    assert len(keys) > 150
    for key in keys:
        value = attrgetter(key)(config)
        assert told_of(config, key, value) == ""
        beyond = [filled(value, odd) for odd in (math.nan, math.inf, -math.inf)]
        for bad in [*beyond, filled(value, 1e30), filled(value, -1e30)]:
            told = told_of(config, key, bad)
            assert told.startswith(f"{key} is "), key
            assert " must " in told


# ------------------------------------------------------------------ malformed values, drawn

DRAWS = 300
ODD = ("nan", "inf", "-inf", "-1", "0", "1e30", "''", "[]", "abc", "[1]", "null", "{a: 1}", "true")
NEVER = {"nan", "inf", "-inf", "1e30", "''", "abc", "{a: 1}", "true"}  # for no number


def drawn(rng: random.Random, config: Any) -> tuple[str, Any, str]:
    """A key of a config, its value, and a malformed one as it is typed."""
    key, value = rng.choice([*leaves(config)])
    more = [value[::-1], [*value, *value[:1]]] if isinstance(value, list) else []
    odd = [*ODD, *map(str, more)]
    return key, value, rng.choice(odd)


def outcome(config: Any, tree: DictConfig, key: str, text: str) -> tuple[str | None, Any]:
    """The sentence of a refusal, or None and the value that was accepted.

    Like composing and checking the whole config, which would take too long for so many: the value
    is parsed by Hydra, converted by OmegaConf's `tree`, and checked with the rest of the config.
    """
    _, owner, name = owner_of(config, key)
    before, converted = getattr(owner, name), OmegaConf.select(tree, key)
    try:
        parsed = OverridesParser.create().parse_override(f"{key}={text}").value()
        OmegaConf.update(tree, key, parsed)
        node = OmegaConf.select(tree, key)
        value = OmegaConf.to_container(node) if OmegaConf.is_config(node) else node
        setattr(owner, name, value)
        if isinstance(config, Config):
            validate(config)
        else:
            validate_segmentation_training(config)
    except Exception as error:
        return to_sentence(error) or f"TRACEBACK {error!r}", None
    finally:
        setattr(owner, name, before)
        OmegaConf.update(tree, key, converted)
    return None, value


def segmentation_training() -> SegmentationTrainingConfig:
    return typed_segmentation_training(compose.compose_config(name="train_segmentation"))


def test_a_malformed_value_ends_in_a_sentence_or_is_legal() -> None:
    rng = random.Random(7)
    configs: list[Any] = [copy.deepcopy(real_config(*overrides)) for overrides in COMPONENTS]
    configs.append(segmentation_training())
    trees = [OmegaConf.structured(config) for config in configs]
    refused = 0
    for _ in range(DRAWS):
        config, tree = rng.choice([*zip(configs, trees, strict=True)])
        key, before, text = drawn(rng, config)
        told, value = outcome(config, tree, key, text)
        case = f"{key}={text}: {told}"
        if told is not None:
            refused += 1
            assert "TRACEBACK" not in told, case
            assert "\n" not in told, case
            assert len(told) > 15, case
            assert told.endswith((".", "!", "?")), case
            continue
        if is_numeric(before):
            assert text not in NEVER, case
            assert told_of(config, key, value) == "", case
        if text == "null":
            _, owner, name = owner_of(config, key)
            assert type(None) in get_args(get_type_hints(type(owner))[name]), case
    assert refused > 0.6 * DRAWS


# What once ended as done, or in a traceback.
REFUSED = """
    env.physics.timestep=0 env.physics.impratio=nan env.physics.sliding_friction=-1
    env.physics.sliding_friction=nan env.physics.rolling_friction=inf env.physics.settle_seconds=inf
    env.physics.solref=[nan,1] env.physics.solref=[-1,1] env.physics.cone=round
    env.push.length=nan env.push.length=-1 env.push.speed=inf env.push.clearance=nan
    env.push.height=-1 env.push.height=inf env.push.plane_height=nan env.push.approach=inf
    env.arena.camera_tilt=-30 env.arena.camera_tilt=nan env.arena.camera_fovy=0
    env.arena.camera_fovy=180 env.arena.camera_distance=-1 env.arena.camera_distance=inf
    env.arena.spawn_x=[0.2,-0.2] env.arena.spawn_x=[0.1] env.arena.spawn_y=[nan,0.1]
    env.arena.range_x=[-inf,inf] env.arena.reach_y=[0.4,-0.2] env.arena.table_rgba=[1,1]
    env.arena.image_size=0 env.arena.image_size=-96 env.arena.image_size=100000
    env.success_threshold=nan env.success_threshold=-1 env.success_threshold=inf
    env.reward.progress=nan env.reward.success=inf env.reward.floor=nan
    env.scenario.max_tries=-1 eval.episodes=1000000000 eval.epsilon=nan eval.epsilon=2
    budget.minutes=0 budget.minutes=-1 budget.minutes=nan curriculum.window=-3
    curriculum.counts=[4,2] collector.workers=-1 train.learning_rate=nan train.learning_rate=inf
    train.utd_ratio=nan train.replay_capacity=10000000000 runtime.device=tpu
    env.perception.min_pixels=0
"""


@pytest.mark.parametrize("override", REFUSED.split())
def test_nonsense_is_refused(override: str) -> None:
    config, (key, _, text) = real_config(*COMPONENTS[0]), override.partition("=")
    told, _ = outcome(config, tree_of(COMPONENTS[0]), key, text)
    assert told is not None
    assert told.startswith(f"{key} is "), told
    assert " must " in told


@cache
def tree_of(overrides: tuple[str, ...]) -> DictConfig:
    return OmegaConf.structured(real_config(*overrides))


@pytest.mark.parametrize("seed", range(4))
def test_the_same_for_a_whole_config(seed: int) -> None:
    rng = random.Random(seed)
    overrides = rng.choice(COMPONENTS)
    while True:
        key, before, text = drawn(rng, real_config(*overrides))
        if is_numeric(before) and text in NEVER:
            break
    with pytest.raises(Exception) as raised:
        typed(compose_config(*overrides, f"++{key}={text}"))
    told = to_sentence(raised.value)
    assert told is not None, f"{key}={text}"
    assert key.removeprefix("train.") in told


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("env.physics.timestep=nan", "env.physics.timestep is nan, but must lie between"),
        ("eval.episodes=1000000000", "eval.episodes is 1000000000, but must lie between 1 and"),
        ("env.arena.table_rgba=[1,1]", "env.arena.table_rgba is [1.0, 1.0], but must be 4"),
        ("curriculum.counts=[4,2]", "curriculum.counts is [4, 2], but must list numbers"),
    ],
)
def test_the_command_refuses_in_a_sentence(override: str, told: str, tmp_path: Path) -> None:
    more = ["model=sdfgcn", "curriculum=on", f"hydra.run.dir={tmp_path / 'run'}"]
    command = [sys.executable, str(RUN), override, *more]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 1
    folder, sentence = done.stderr.splitlines()
    assert folder.startswith("Run folder: ")
    assert sentence.startswith(told)
    assert "done" not in (tmp_path / "run" / "status.json").read_text()
    assert not (tmp_path / "run" / "results.json").exists()
