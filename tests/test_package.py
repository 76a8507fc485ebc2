"""The installed package: its wheel, its names for Python, and components of other packages."""

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from importlib.metadata import EntryPoint
from pathlib import Path

import hydra
import pytest
from configs import CONF
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig

import sdfgcn
from sdfgcn import registry
from sdfgcn.errors import SdfgcnError

ROOT = Path(__file__).parents[1]


def python(code: str, *folders: Path) -> str:
    """What a script prints that finds the package, and what the folders hold."""
    path = os.pathsep.join(map(str, (*folders, ROOT)))
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (built,) = folder.glob(f"sdfgcn-{sdfgcn.__version__}-*.whl")
    return built


def test_the_installed_wheel_evaluates_its_weights(wheel: Path, tmp_path: Path) -> None:
    """In a virtual environment of its own, which sees the dependencies of this one."""
    home = tmp_path / "venv"
    venv.create(home, symlinks=True)
    (site,) = home.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", str(home / "bin" / "python"), "install"]
    subprocess.run([*pip, "-q", "--no-deps", str(wheel)], check=True, capture_output=True)
    shrunk = ("objects=household", "robot=gripper", "n_objects=2", "env.pushes_per_object=2")
    shrunk += ("eval.episodes=1", "eval.baseline=null", "viz=none", "runtime.workers=0")
    done = subprocess.run(
        [home / "bin" / "sdfgcn", *shrunk, "hydra.run.dir=here"],
        cwd=tmp_path,
        env={key: value for key, value in os.environ.items() if key != "PYTHONPATH"},
        capture_output=True,
        text=True,
        timeout=480,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == "Run folder: here\n"  # and no package's log lines
    assert "push_model (this run)" in done.stdout
    results = json.loads((tmp_path / "here" / "results.json").read_text())
    assert (results["checkpoint"], results["episodes"]) == ("push_model", 1)
    assert results["git"] is None  # it is of the installed package, not of the checkout


def test_the_wheel_holds_all_that_a_run_reads(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as file:
        names = set(file.namelist())
        (entry_points,) = (name for name in names if name.endswith("entry_points.txt"))
        assert "sdfgcn = sdfgcn.cli:main" in file.read(entry_points).decode()
    conf = {f"sdfgcn/conf/{path.relative_to(CONF).as_posix()}" for path in CONF.rglob("*.yaml")}
    assert conf == {name for name in names if name.endswith(".yaml")}
    weights = {path.relative_to(ROOT).as_posix() for path in ROOT.glob("sdfgcn/**/*.safetensors")}
    assert len(weights) == 3  # two policies and the segmenter
    assert weights < names
    assert {name.split("/")[0].partition("-")[0] for name in names} == {"sdfgcn"}


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import sys, sdfgcn; print({'torch', 'mujoco', 'hydra'} & set(sys.modules))"
    assert python(code) == "set()\n"


def test_make_env_needs_no_set_up() -> None:
    code = """
import sdfgcn
with __import__("contextlib").closing(sdfgcn.make_env("objects=household", "n_objects=2")) as env:
    print(sdfgcn.load_policy("sdfgcn")(env.reset_episode(0))["action_mask"].shape)
"""
    assert python(code) == "torch.Size([64])\n"


def test_configs_compose_inside_a_hydra_application(monkeypatch: pytest.MonkeyPatch) -> None:
    composed = []

    @hydra.main(str(CONF), "config", version_base="1.3")
    def application(cfg: DictConfig) -> None:
        outer = GlobalHydra.instance().hydra
        composed.append(sdfgcn.load_config("n_objects=2").n_objects)
        assert GlobalHydra.instance().hydra is outer
        composed.append(cfg.n_objects)

    monkeypatch.setattr(sys, "argv", ["application", "n_objects=4", "hydra.run.dir=."])
    application()
    assert composed == [2, 4]
    assert not GlobalHydra.instance().is_initialized()


TOY = """
from dataclasses import dataclass

from omegaconf import MISSING

from sdfgcn.config import ModelConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import MODELS


@dataclass
class ToyConfig(ModelConfig):
    depth: int = MISSING

    def check(self, config):
        if self.depth > 3:
            raise SdfgcnError(f"model.depth is {self.depth}, but must be at most 3.")


@MODELS.register("toy", config=ToyConfig)
def toy(config, rng):
    return f"depth {config.model.depth}"
"""
USE = """
import sys

import sdfgcn
from sdfgcn.cli import to_sentence
from sdfgcn.registry import MODELS

config = sdfgcn.load_config("model=toy", "model.depth=2")
print(MODELS.find(config.model.name)(config, None))
for override in ("model.depth=4", "model.depht=1"):
    try:
        sdfgcn.load_config("model=toy", override)
    except Exception as error:
        print(to_sentence(error))
sys.argv = ["sdfgcn", "--help"]
from sdfgcn.cli import main
main()
"""


def test_components_of_another_package(tmp_path: Path) -> None:
    files = {
        "toy/__init__.py": "",
        "toy/rule.py": TOY,
        "toy/conf/model/toy.yaml": "# Pushes toys. Slowly.\nname: toy\ndepth: 1\n",
        "toy-1.0.dist-info/METADATA": "Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n",
        "toy-1.0.dist-info/entry_points.txt": "[sdfgcn.components]\ntoy = toy.rule\n",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    first, second, third, *shown = python(USE, tmp_path).splitlines()
    assert first == "depth 2"
    assert second == "model.depth is 4, but must be at most 3."
    assert third == "There is no key 'model.depht'; did you mean model.depth?"
    assert "Pushes toys" in next(line for line in shown if line.split()[:1] == ["toy"])


def test_a_package_that_cannot_be_imported_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = EntryPoint("toys", "no_such_package.toys", registry.PLUGINS)
    monkeypatch.setattr(registry, "plugins", lambda: (broken,))
    told = r"entry point 'toys' \(no_such_package\.toys\) cannot be imported \(ModuleNotFoundError"
    with pytest.raises(SdfgcnError, match=told):
        registry.ROBOTS.find("gripper")
