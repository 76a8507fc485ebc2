"""Composing configs from the YAML files of `conf/`, leaving Hydra's global state as it was."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.core.utils import JobRuntime
from hydra.plugins.search_path_plugin import SearchPathPlugin
from omegaconf import DictConfig

from sdfgcn.config import Config
from sdfgcn.registry import PLUGINS, plugins
from sdfgcn.validation import typed

_PACKAGE = Path(__file__).resolve().parent


def conf_dir() -> Path:
    """The folder of YAML files: inside the installed package, or at the root of a checkout."""
    packaged = _PACKAGE / "conf"
    return packaged if packaged.is_dir() else _PACKAGE.parent / "conf"


def component_dirs() -> list[Path]:
    """The `conf` folders of other packages that register components."""
    modules = [find_spec(plugin.module) for plugin in plugins()]
    files = [Path(module.origin) for module in modules if module and module.origin]
    return [file.parent / "conf" for file in files if (file.parent / "conf").is_dir()]


class ComponentsSearchPath(SearchPathPlugin):
    """Lets Hydra find the options that other packages add to config groups."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        """Append the `conf` folders of those packages."""
        for folder in component_dirs():
            search_path.append(PLUGINS, str(folder))


def register_search_path() -> None:
    """Make Hydra search other packages too; call this before it composes."""
    Plugins.instance().register(ComponentsSearchPath)


def compose_config(overrides: Sequence[str] = (), name: str = "config") -> DictConfig:
    """Compose a config as the command line does; also works inside a Hydra application.

    Raises:
        HydraException: An override cannot be parsed, or names a missing key or option.
    """
    register_search_path()
    outer, job = GlobalHydra.instance().hydra, JobRuntime.instance().get("name")
    GlobalHydra.instance().clear()  # otherwise Hydra refuses a second initialisation
    try:
        with initialize_config_dir(str(conf_dir()), job_name=job, version_base="1.3"):
            return compose(name, list(overrides))
    finally:
        GlobalHydra.instance().hydra = outer


def load_config(*overrides: str) -> Config:
    """The experiment's config, checked.

    Args:
        overrides: As on the command line: `load_config("n_objects=2", "robot=gripper")`.

    Raises:
        SdfgcnError: A value is out of range or contradicts another.
        HydraException: An override cannot be parsed, or names a missing key or option.
        OmegaConfBaseException: A value is missing or of the wrong type.
    """
    return typed(compose_config(overrides))
