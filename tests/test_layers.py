"""The shape of the house: who may import whom, and that conf/ and the code name the same things."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from configs import CONF, real_config
from omegaconf import OmegaConf

from sdfgcn.registry import REGISTRIES, Registry

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "sdfgcn").rglob("*.py"))

# Lowest first. A module imports its own layer and lower ones, never higher ones.
LAYERS = (
    ("errors", "signals"),
    ("config",),
    ("files", "opengl", "processes", "provenance"),
    ("registry",),
    ("validation",),
    ("compose",),
    ("loggers", "objects"),
    ("task",),
    ("sim",),
    ("perception",),
    ("models", "segmentation"),
    ("envs",),
    ("agents",),
    ("train", "viz"),
    ("evaluation",),
    ("run_folder",),
    ("experiment", "sweep"),
    ("comparison",),
    ("cli",),
)
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}

# Each only in the folder that needs it.
OPTIONAL = {"rerun": "viz", "trimesh": "sources", "coacd": "sources"}

# Loaded only by what needs them; torch takes seconds, and MuJoCo fails to load without OpenGL.
LAZY = (*OPTIONAL, "torch", "torchrl", "tensordict", "mujoco", "dm_control", "scipy")

OPTIONS = sorted((path.parent.name, path.stem) for path in CONF.glob("*/*.yaml"))
YAMLS = sorted(CONF.rglob("*.yaml"))


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(node: ast.AST) -> Iterator[str]:
    """Every name imported by one statement, as dotted paths."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        assert node.level == 0, "relative imports are not used here"
        for alias in node.names:
            yield f"{node.module}.{alias.name}"


def imports_anywhere(path: Path) -> set[str]:
    return {name for node in ast.walk(ast.parse(path.read_text())) for name in imports(node)}


def imports_on_loading(path: Path) -> set[str]:
    """What the module's own body imports, apart from `if TYPE_CHECKING`."""
    found: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test):
            continue
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            continue
        for inner in ast.walk(node):
            found.update(imports(inner))
    return found


def loaded_with(path: Path) -> set[str]:
    """Every module that importing a file loads, through our own modules."""
    by_name = {module_name(file): file for file in FILES}
    seen: set[str] = set()
    waiting = [path]
    while waiting:
        for name in imports_on_loading(waiting.pop()) - seen:
            seen.add(name)
            parts = name.split(".")
            parents = {".".join(parts[:end]) for end in range(1, len(parts) + 1)}
            waiting += [by_name[parent] for parent in parents & by_name.keys()]
    return seen


@pytest.mark.parametrize("path", FILES, ids=module_name)
def test_imports_nothing_higher(path: Path) -> None:
    own = module_name(path).split(".")
    if own == ["sdfgcn"]:
        # What users import by name is loaded when it is asked for.
        assert not {name for name in imports_on_loading(path) if name.startswith("sdfgcn")}
        return
    rank = RANK[own[1]]
    used = {name.split(".")[1] for name in imports_anywhere(path) if name.startswith("sdfgcn.")}
    assert {name for name in used if RANK[name] > rank} == set()
    peers = {name for name in used if RANK[name] == rank}
    assert peers <= {own[1]}, "modules of one layer do not know each other"


PERCEPTION = [path for path in FILES if "perception" in path.relative_to(ROOT).parts]


@pytest.mark.parametrize("path", PERCEPTION, ids=module_name)
def test_perception_knows_no_simulation(path: Path) -> None:
    """It sees a real table as it sees a simulated one, so nothing of it may need MuJoCo."""
    used = {".".join(name.split(".")[:2]) for name in imports_anywhere(path)}
    assert "sdfgcn.sim" not in used
    assert {name.partition(".")[0] for name in used}.isdisjoint({"mujoco", "dm_control"})


def test_run_loads_nothing_heavy() -> None:
    loaded = {name.partition(".")[0] for name in loaded_with(ROOT / "run.py")}
    assert {"sdfgcn", "hydra"} <= loaded
    assert loaded.isdisjoint(LAZY)


@pytest.mark.parametrize("path", FILES, ids=module_name)
def test_an_optional_package_stays_in_its_folder(path: Path) -> None:
    used = {name.partition(".")[0] for name in imports_anywhere(path)}
    for package, folder in OPTIONAL.items():
        assert package not in used or path.parent.name == folder


@pytest.mark.parametrize("registry", REGISTRIES, ids=lambda registry: registry.group)
def test_registry_and_conf_name_the_same_things(registry: Registry) -> None:
    assert set(registry) == {path.stem for path in (CONF / registry.group).glob("*.yaml")}


@pytest.mark.parametrize(("group", "option"), OPTIONS)
def test_every_option_composes_and_is_named_after_its_file(
    group: str, option: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)  # for runtime=gpu
    trained = ["model=sdfgcn"] if group == "curriculum" else []
    config = real_config(f"{group}={option}", *trained)
    places = (config, config.env, config.env.perception)
    part = next(getattr(place, group) for place in places if hasattr(place, group))
    assert part.name == option


def test_every_group_has_an_option_that_is_the_default() -> None:
    defaults = {}
    for entry in OmegaConf.load(CONF / "config.yaml").defaults:
        if OmegaConf.is_dict(entry):
            defaults.update({key.partition("@")[0]: entry[key] for key in entry if "@" not in key})
    assert set(defaults.items()) <= set(OPTIONS)
    assert set(defaults) == {group for group, _ in OPTIONS}


@pytest.mark.parametrize("path", YAMLS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_number_has_a_comment(path: Path) -> None:
    text = path.read_text()
    lines = text.splitlines()
    bare = [lines[line] for line in lines_with_numbers(text) if "#" not in lines[line]]
    assert not bare


def lines_with_numbers(text: str) -> set[int]:
    """Where numbers stand in a YAML text."""

    def search(node: yaml.Node) -> Iterator[int]:
        if isinstance(node, yaml.MappingNode):
            for _, value in node.value:
                yield from search(value)
        elif isinstance(node, yaml.SequenceNode):
            for item in node.value:
                yield from search(item)
        elif re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", node.value):
            yield node.start_mark.line

    return set(search(yaml.compose(text)))


def test_numbers_are_found() -> None:
    assert lines_with_numbers("a: 1\nb: x2\nc: [0.5,\n  -1e-3]\nd: {e: 3}\nf: null") == {0, 2, 3, 4}


@pytest.mark.parametrize("path", FILES, ids=module_name)
def test_files_are_short(path: Path) -> None:
    assert len(path.read_text().splitlines()) <= 350
