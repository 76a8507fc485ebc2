"""From Hydra's config to checked dataclasses, with the checks that `sdfgcn/config/` cannot make."""

from __future__ import annotations

import copy
import functools
from dataclasses import fields, replace
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf

from sdfgcn.config import Config, QNetworkConfig, SegmentationTrainingConfig, check_ranges
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import MODELS, OBJECTS, REGISTRIES, Registry

T = TypeVar("T", Config, SegmentationTrainingConfig)


def typed(cfg: DictConfig) -> Config:
    """Convert the config that Hydra composed to dataclasses, and check it.

    Raises:
        SdfgcnError: A component is unknown, or a value is out of range or contradicts another.
        OmegaConfBaseException: A key is unknown, a value is missing or of the wrong type, or an
            interpolation cannot be resolved.
    """
    values: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    train = values["train"]
    train["env"] = _with_changes(values["env"], train.get("env", {}))
    _check_without_components(values)
    config = _structured(Config, values)
    validate(config)
    return config


def _check_without_components(values: dict[str, Any]) -> None:
    """Check types and ranges of what all components of a group share.

    Components bring torch and MuJoCo, which take seconds to import; most mistakes need neither.
    """
    plain = copy.deepcopy(values)
    for registry in REGISTRIES:
        *parents, last = registry.path.split(".")
        node = functools.reduce(dict.__getitem__, parents, plain)
        if not isinstance(node[last], dict):
            raise SdfgcnError(
                f"{registry.path} is '{node[last]}', but holds the keys of a component; pick one "
                f"with {registry.group}=... instead."
            )
        shared = {field.name for field in fields(registry.base)}
        node[last] = {key: value for key, value in node[last].items() if key in shared}
    plain["train"]["env"] = plain["env"]
    schema = OmegaConf.structured(Config)
    check_ranges(OmegaConf.to_object(OmegaConf.merge(schema, plain)))


def typed_segmentation_training(cfg: DictConfig) -> SegmentationTrainingConfig:
    """The same for the training of the segmentation network (`conf/train_segmentation.yaml`)."""
    values: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    config = _structured(SegmentationTrainingConfig, values)
    validate_segmentation_training(config)
    return config


def _with_changes(base: Any, changes: Any) -> Any:
    """`base` with some keys changed; a component of another name replaces it as a whole."""
    if not (isinstance(base, dict) and isinstance(changes, dict)):
        return changes
    if changes.get("name", base.get("name")) != base.get("name"):
        return changes
    changed = {key: _with_changes(base.get(key), value) for key, value in changes.items()}
    return {**base, **changed}


def _structured(root: type[T], values: dict[str, Any]) -> T:
    """Convert plain values to dataclasses; merging rejects unknown keys."""
    schema = OmegaConf.structured(root)
    for registry in REGISTRIES:
        for path in (registry.path, f"train.{registry.path}"):
            _set_type(schema, values, path, registry)
    for name in values.get("catalogues", {}):
        _set_type(schema, values, f"catalogues.{name}", OBJECTS)
    config = OmegaConf.to_object(OmegaConf.merge(schema, values))
    assert isinstance(config, root)
    return config


def _set_type(schema: DictConfig, values: dict[str, Any], path: str, registry: Registry) -> None:
    """Give the component at `path`, if any, the config type of its name."""
    component: Any = values
    for key in path.split("."):
        component = component.get(key) if isinstance(component, dict) else None
    if isinstance(component, dict):
        component_type = registry.config_type(str(component.get("name")))
        OmegaConf.update(schema, path, component_type, merge=False, force_add=True)


def validate(config: Config) -> None:
    """Check what the types cannot.

    Raises:
        SdfgcnError: One sentence that names the key, its value and what would work.
    """
    _validate_env(config)
    try:
        _validate_env(replace(config, env=config.train.env))
    except SdfgcnError as error:
        raise SdfgcnError(f"In train.env, {error}") from None
    check_ranges(config)
    if config.env.split != config.eval.split:
        raise SdfgcnError(
            f"env.split is '{config.env.split}' while eval.split is '{config.eval.split}': set "
            "eval.split alone, and env.split follows it."
        )
    _validate_device(config.runtime.device)
    _validate_baseline(config)
    for component in (config.model, config.logger, config.viz):
        component.check(config)
    trained = isinstance(config.model, QNetworkConfig) and config.checkpoint is None
    if isinstance(config.model, QNetworkConfig):
        _validate_training(config)
    elif config.checkpoint is not None:
        raise SdfgcnError(
            f"checkpoint is '{config.checkpoint}', but model={config.model.name} has no weights to "
            "load; leave it out, or pick the model that the checkpoint was trained for."
        )
    if not trained and config.curriculum.name not in ("off", config.model.own_curriculum):
        raise SdfgcnError(
            f"curriculum={config.curriculum.name} has no effect, as nothing is trained; leave it "
            "out, or train with model=sdfgcn and without a checkpoint."
        )


def _validate_env(config: Config) -> None:
    env = config.env
    check_ranges(env, "env")
    if env.n_objects > env.max_objects:
        raise SdfgcnError(
            f"n_objects is {env.n_objects}, but must lie between 1 and env.max_objects "
            f"({env.max_objects})."
        )
    for axis in ("x", "y"):
        spawn, allowed = getattr(env.arena, f"spawn_{axis}"), getattr(env.arena, f"range_{axis}")
        if not allowed[0] <= spawn[0] <= spawn[1] <= allowed[1]:
            raise SdfgcnError(
                f"env.arena.spawn_{axis} is {spawn}, but must lie within env.arena.range_{axis} "
                f"({allowed}), outside which an episode has failed."
            )
    ticks = env.push.control_timestep / env.physics.timestep
    if not (ticks >= 0.5 and abs(ticks - round(ticks)) < 1e-6):
        raise SdfgcnError(
            f"env.push.control_timestep is {env.push.control_timestep}, but must be a multiple of "
            f"env.physics.timestep ({env.physics.timestep})."
        )
    for component in (
        *(env.world, env.objects, env.robot, env.scenario),
        *(env.perception, env.perception.encoder, env.perception.segmentation),
    ):
        component.check(config)


def _validate_baseline(config: Config) -> None:
    """The baseline plays after the model, which is late to find that it cannot."""
    untrained = [
        name for name in MODELS if not issubclass(MODELS.config_type(name), QNetworkConfig)
    ]
    baseline = config.eval.baseline
    if baseline not in (None, config.model.name, *untrained):
        raise SdfgcnError(
            f"eval.baseline is '{baseline}', but must be null or a model without weights: "
            f"{', '.join(untrained)}."
        )


def _validate_device(device: str) -> None:
    if device.startswith("cuda"):
        import torch  # here, as the import takes seconds

        if not torch.cuda.is_available():
            raise SdfgcnError(
                f"runtime.device is '{device}', but torch sees no GPU here; use runtime=cpu."
            )
        number = int(device.partition(":")[2] or 0)
        if number and number >= torch.cuda.device_count():
            raise SdfgcnError(
                f"runtime.device is '{device}', but the last GPU here is "
                f"cuda:{torch.cuda.device_count() - 1}."
            )


def _validate_training(config: Config) -> None:
    train, counts = config.train, config.curriculum.counts
    if counts and max(counts) > config.env.max_objects:
        raise SdfgcnError(
            f"curriculum.counts is {counts}, but every count must lie between 1 and "
            f"env.max_objects ({config.env.max_objects})."
        )
    if config.curriculum.name == "on" and config.curriculum.window == 0:
        raise SdfgcnError(
            "curriculum.window is 0, but must be at least 1 with curriculum=on: the number of "
            "episodes that measure a success rate."
        )
    for lesser, greater in (
        ("epsilon_end", "epsilon_start"),
        ("batch_size", "replay_capacity"),
        ("utd_ratio", "max_utd_ratio"),
    ):
        low, high = getattr(train, lesser), getattr(train, greater)
        if low > high:
            raise SdfgcnError(
                f"train.{lesser} is {low}, but must not be above train.{greater} ({high})."
            )


def validate_segmentation_training(config: SegmentationTrainingConfig) -> None:
    """Check what the types cannot, for the training of the segmentation network.

    Raises:
        SdfgcnError: One sentence that names the key, its value and what would work.
    """
    check_ranges(config)
    if not config.catalogues:
        raise SdfgcnError("catalogues is empty, but at least one object catalogue is needed.")
