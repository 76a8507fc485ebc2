"""Components picked by name in the config: one registry per config group.

A component registers itself and its config dataclass where it is defined:

    @ROBOTS.register("gripper", config=GripperConfig)
    class FloatingGripper(Robot): ...

Its file lies in the package that the registry names, and `conf/<group>/<name>.yaml` holds its
numbers; no other file has to mention it. Another installed package adds components through an
entry point of the group `sdfgcn.components` that names one of its modules: importing the module
registers them, and a folder `conf` beside it holds their YAML.
"""

from __future__ import annotations

import functools
import importlib
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from sdfgcn.config import (
    ComponentConfig,
    EncoderConfig,
    LoggerConfig,
    ModelConfig,
    ObjectsConfig,
    PerceptionConfig,
    RobotConfig,
    ScenarioConfig,
    SegmentationConfig,
    VizConfig,
    WorldConfig,
    lookup,
)
from sdfgcn.errors import SdfgcnError

PLUGINS = "sdfgcn.components"  # the group of entry points


class Registry(Mapping[str, Any]):
    """Maps the options of one config group to their builders and config dataclasses.

    The modules that register components are imported at the first lookup.
    """

    def __init__(self, path: str, modules: str, base: type[ComponentConfig]) -> None:
        """Make an empty registry.

        Args:
            path: Where the config group sits in the config, such as "env.robot"; the last part is
                its folder in `conf/`.
            modules: The modules that register components; "package.*" for all in a package.
            base: The config dataclass of components that add no keys.
        """
        self.group = path.rpartition(".")[2]
        self.path = path
        self._modules = modules.split()
        self.base = base
        self._builders: dict[str, Any] = {}
        self._configs: dict[str, type[ComponentConfig]] = {}

    def register(
        self, *names: str, config: type[ComponentConfig] | None = None
    ) -> Callable[[Any], Any]:
        """Register the decorated class or function as the builder of the options `names`.

        `config` is their config dataclass; None stands for the group's base.

        Raises:
            ValueError: A name is already registered.
        """

        def decorate(builder: Any) -> Any:
            for name in names:
                if name in self._builders:
                    raise ValueError(f"{self.group}={name} is registered twice")
                self._builders[name] = builder
                self._configs[name] = config or self.base
            return builder

        return decorate

    def find(self, name: str) -> Any:
        """The builder of a component.

        Raises:
            SdfgcnError: There is no such component.
        """
        self._load()
        return lookup(self._builders, f"{self.path}.name", name)

    def config_type(self, name: str) -> type[ComponentConfig]:
        """The config dataclass of a component.

        Raises:
            SdfgcnError: There is no such component.
        """
        self._load()
        return lookup(self._configs, f"{self.path}.name", name)

    def __getitem__(self, name: str) -> Any:
        self._load()
        return self._builders[name]

    def __iter__(self) -> Iterator[str]:
        self._load()
        return iter(sorted(self._builders))

    def __len__(self) -> int:
        self._load()
        return len(self._builders)

    def _load(self) -> None:
        """Import every module that may register a component; repeated calls cost nothing."""
        for name in self._modules:
            package = importlib.import_module(name.removesuffix(".*"))
            if name.endswith(".*"):
                for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
                    importlib.import_module(module.name)
        for plugin in plugins():
            try:
                importlib.import_module(plugin.module)
            except Exception as error:  # whatever another package's code raises
                raise SdfgcnError(
                    f"The components of the entry point '{plugin.name}' ({plugin.module}) cannot "
                    f"be imported ({type(error).__name__}: {error}); repair that package or "
                    "uninstall it."
                ) from error


@functools.cache
def plugins() -> tuple[EntryPoint, ...]:
    """The entry points through which other packages add components."""
    return tuple(entry_points(group=PLUGINS))


MODELS = Registry("model", "sdfgcn.models.* sdfgcn.agents.*", ModelConfig)
WORLDS = Registry("env.world", "sdfgcn.sim.world", WorldConfig)
OBJECTS = Registry("env.objects", "sdfgcn.objects.sources.*", ObjectsConfig)
ROBOTS = Registry("env.robot", "sdfgcn.sim.robots.*", RobotConfig)
SCENARIOS = Registry("env.scenario", "sdfgcn.sim.scenarios.*", ScenarioConfig)
PERCEPTIONS = Registry("env.perception", "sdfgcn.perception.*", PerceptionConfig)
ENCODERS = Registry("env.perception.encoder", "sdfgcn.perception.encoders.*", EncoderConfig)
SEGMENTERS = Registry(
    "env.perception.segmentation", "sdfgcn.perception.segmenters.*", SegmentationConfig
)
LOGGERS = Registry("logger", "sdfgcn.loggers.*", LoggerConfig)
RECORDERS = Registry("viz", "sdfgcn.viz", VizConfig)

# Outer configs come before those nested in them.
REGISTRIES = (
    *(MODELS, WORLDS, OBJECTS, ROBOTS, SCENARIOS),
    *(PERCEPTIONS, ENCODERS, SEGMENTERS, LOGGERS, RECORDERS),
)
