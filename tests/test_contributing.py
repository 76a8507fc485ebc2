"""The recipes of CONTRIBUTING.md, followed to the letter in a copy of the package."""

from __future__ import annotations

import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from configs import real_config

from sdfgcn.objects.catalogue import catalogue_folder, load_catalogue

ROOT = Path(__file__).parents[1]
# A fenced block whose first line is a comment that names its file.
BLOCK = re.compile(r"^```\w+\n# (\S+\.\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BLOCKS = dict(BLOCK.findall((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")))
PACKAGE = {name: text for name, text in BLOCKS.items() if not name.startswith(("sdfgcn", "conf"))}

# Option -> an override of its own key, and one that is refused, with the sentence that says so.
TOYS = {
    "objects=toy_boxes": (
        *("env.objects.side=0.06", "env.objects.side=0.0"),
        "env.objects.side is 0.0, but must be above 0.",
    ),
    "scenario=toy_shift": (
        *("env.scenario.reach=0.1", "env.scenario.reach=0.7"),
        "env.scenario.reach is 0.7, but must be below 0.5, the width of env.arena.spawn_x.",
    ),
    "model=toy_nearest": (
        *("model.margin=0.1", "model.margin=-1.0"),
        "model.margin is -1.0, but must be at least 0.",
    ),
    "model=toy_net": (
        *("model.depth=2", "model.depth=0"),
        "model.depth is 0, but must be at least 1.",
    ),
    "robot=toy_gripper": (
        *("env.robot.ease=2.0", "env.robot.ease=0.5"),
        "env.robot.ease is 0.5, but must be at least 1.",
    ),
    "perception=toy_eroded": (
        *("env.perception.rim=2", "env.perception.rim=0"),
        "env.perception.rim is 0, but must be at least 1.",
    ),
    "encoder=toy_pyramid": (
        *("env.perception.encoder.factor=3", "env.perception.encoder.factor=1"),
        "env.perception.encoder.factor is 1, but must be at least 2.",
    ),
    "segmentation=toy_colour": (
        *("env.perception.segmentation.tolerance=0.04", "env.perception.segmentation.tolerance=0"),
        "env.perception.segmentation.tolerance is 0.0, but must be above 0.",
    ),
    "logger=toy_lines": (
        *("logger.digits=2", "logger.digits=-1"),
        "logger.digits is -1, but must be at least 0.",
    ),
    "model=toy_biased": (
        *("model.bias=1.0", "model.bias=2.0"),
        "model.bias is 2.0, but must lie between 0 and 1.",
    ),
}
# Reads TOYS. Writes what is refused, with which options it composes, and two pushes with each toy.
USE = """
import json
import sys

import sdfgcn
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import REGISTRIES

toys = json.loads(sys.argv[1])
said = {}
for option, (own, refused, _) in toys.items():
    if option.startswith(("model", "logger")):
        sdfgcn.load_config(option, own)
    try:
        sdfgcn.load_config(option, refused)
    except SdfgcnError as error:
        said[option] = str(error)
groups = [[f"{registry.group}={name}" for name in registry] for registry in REGISTRIES]
for number in range(max(map(len, groups))):  # several at once: composing takes long
    sdfgcn.load_config(*(group[number % len(group)] for group in groups))
both = sdfgcn.load_config("robot=ur5e", "robot@train.env.robot=toy_gripper")
moved = []
for seen in (
    ["perception=toy_eroded"],
    ["perception=vision", "encoder=toy_pyramid", "segmentation=toy_colour"],
):
    options = ["objects=toy_boxes", "scenario=toy_shift", "robot=toy_gripper", *seen]
    own = [toys[option][0] for option in options if option in toys]
    env = sdfgcn.make_env(*options, *own, "n_objects=2")
    first = env.reset_episode(1)
    shift = (first["goal", "center"] - first["scene", "center"])[first["matched"]]
    pushes = env.rollout(2, env.rand_action, auto_reset=False, tensordict=first)
    moved.append([shift.tolist(), pushes["next", "reward"].flatten().tolist()])
    env.close()
print(json.dumps([said, groups, [both.env.robot.name, both.train.env.robot.name], moved]))
"""


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = folder / name
        assert not path.exists(), f"the recipe changes {name}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The package, its configs and its tests, with what the recipes add."""
    folder = tmp_path_factory.mktemp("copy")
    for name in ("sdfgcn", "conf", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("run.py", "pyproject.toml"):
        shutil.copy(ROOT / name, folder)
    write(folder, {name: text for name, text in BLOCKS.items() if name not in PACKAGE})
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of installed packages that holds the recipes' own one."""
    folder = tmp_path_factory.mktemp("site")
    write(folder, PACKAGE)
    project = tomllib.loads(PACKAGE["pyproject.toml"])["project"]
    lines = []
    for group, names in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {module}" for name, module in names.items())]
    about = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    info = f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    write(folder, {f"{info}/METADATA": about, f"{info}/entry_points.txt": "\n".join(lines)})
    return folder


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache for the recipes' objects, with the household ones that other tests use."""
    config = real_config("objects=household").env.objects
    load_catalogue(config, "test")
    household = catalogue_folder(config)
    folder = tmp_path_factory.mktemp("cache")
    (folder / "objects").mkdir()
    (folder / "objects" / household.name).symlink_to(household)
    return folder


def python(copy: Path, *arguments: object, path: tuple[Path, ...] = (), **env: object) -> str:
    """What Python prints with the copy, and with the packages in other folders."""
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        env={
            **os.environ,
            **{name: str(value) for name, value in env.items()},
            "PYTHONPATH": os.pathsep.join(map(str, (copy, *path))),
        },
        cwd=copy,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_two_files_each() -> None:
    """One in Python and one in YAML of the same name, in the group's folder."""
    modules = {Path(name).stem: name for name in BLOCKS if name.endswith(".py")}
    options = {Path(name).stem: name for name in BLOCKS if name.endswith(".yaml")}
    for option in TOYS:
        group, _, name = option.partition("=")
        assert options.pop(name).endswith(f"conf/{group}/{name}.yaml")
        modules.pop("agent" if name == "toy_biased" else name)
    assert not modules
    assert not options


def test_code_of_the_recipes_is_clean(copy: Path, site: Path) -> None:
    files = [folder / name for folder in (copy, site) for name in BLOCKS if name.endswith(".py")]
    files = [path for path in files if path.exists()]
    for command in (["check"], ["format", "--check"]):
        python(copy, "-m", "ruff", *command, "--config", ROOT / "pyproject.toml", *files)


def test_each_is_checked_built_and_run(copy: Path, site: Path, cache: Path) -> None:
    printed = python(copy, "-c", USE, json.dumps(TOYS), path=(site,), SDFGCN_CACHE=cache)
    said, groups, robots, moved = json.loads(printed)
    assert said == {option: sentence for option, (_, _, sentence) in TOYS.items()}
    options = {option for group in groups for option in group}
    assert TOYS.keys() < options
    assert {"model=sdfgcn", "objects=household", "logger=csv"} < options
    assert robots == ["ur5e", "toy_gripper"]
    for shifts, rewards in moved:
        assert len(shifts) == len(rewards) == 2
        for x, y in shifts:
            assert abs(x - 0.1) < 0.01 and abs(y) < 0.01


def test_models_are_trained_and_evaluated(
    copy: Path, site: Path, cache: Path, tmp_path: Path
) -> None:
    """One sweep: the Q-network, the agent, and the agent of the other package."""
    models = ("toy_net", "toy_nearest", "toy_biased")
    printed = python(
        copy,
        *("run.py", "-m", f"model={','.join(models)}", f"hydra.sweep.dir={tmp_path}"),
        *("objects=toy_boxes", "scenario=toy_shift", "robot=gripper", "n_objects=2"),
        *("logger=toy_lines", "viz=none", "env.pushes_per_object=2", "eval.episodes=1"),
        *("runtime.workers=0", "collector=sync", "collector.pushes_per_batch=5"),
        *("budget=smoke", "budget.pushes=20", "train.learning_starts=5", "train.batch_size=4"),
        *("train.log_pushes=10", "robot@train.env.robot=toy_gripper"),
        path=(site,),
        SDFGCN_CACHE=cache,
    )
    for job, model in enumerate(models):
        assert f"{model} (this run)" in printed
        results = json.loads((tmp_path / str(job) / "results.json").read_text())
        assert (results["model"], results["objects"], results["episodes"]) == (
            *(model, "toy_boxes", 1),
        )
        assert (tmp_path / str(job) / "metrics.jsonl").read_text().startswith('{"step": ')
    with (tmp_path / "0" / "train.csv").open() as file:
        *_, last = csv.DictReader(file)
    assert int(last["pushes"]) == 20
    assert int(last["updates"]) > 0


def test_the_tests_pick_them_up(copy: Path, cache: Path) -> None:
    files = ("layers", "objects", "sim_scenarios", "agents", "models", "perceptions", "matching")
    printed = python(
        copy,
        *("-m", "pytest", "-o", "addopts=", "-v", "-p", "no:cacheprovider"),
        *(f"tests/test_{name}.py" for name in files),
        *("-k", "toy_ or registry_and_conf"),
        SDFGCN_CACHE=cache,
    )
    for test in (
        "test_imports_nothing_higher[sdfgcn.agents.toy_nearest]",
        "test_registry_and_conf_name_the_same_things[logger]",
        "test_every_number_has_a_comment[robot/toy_gripper]",
        "test_learns_under_dqn_loss[toy_net-True]",
        "test_resting_poses_rest[toy_boxes]",
        "test_layouts_keep_region_and_spacing[toy_shift-6]",
        "test_action_is_legal_and_follows_from_the_generator[toy_nearest]",
        "test_specs[toy_eroded]",
        "test_features_are_one_row_an_object[toy_pyramid]",
    ):
        assert f"{test} PASSED" in printed
