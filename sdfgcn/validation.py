"""From Hydra's config to checked dataclasses: what the types in `sdfgcn/config/` cannot say."""

from __future__ import annotations

from omegaconf import DictConfig, OmegaConf

from sdfgcn.config import (
    MODEL_CONFIGS,
    SPLITS,
    Config,
    ConvModelConfig,
    ModelConfig,
    PoseGcnConfig,
    TrainUCNConfig,
    lookup,
)
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import OBJECTS

MOTIONS = ("length", "speed", "acceleration", "descent_speed", "lift_speed")  # of env.push


def typed(cfg: DictConfig) -> Config:
    """Turn Hydra's config into dataclasses and validate it.

    Raises:
        SdfgcnError: A value is out of its range or contradicts another.
        OmegaConfBaseException: A key is unknown, a value is missing or an interpolation leads
            nowhere.
    """
    # Hydra's `+key=value` may have added a key that no dataclass has: merging refuses it.
    values = OmegaConf.to_container(cfg, resolve=True)
    schema = OmegaConf.structured(Config)
    schema.model = MODEL_CONFIGS.get(cfg.model.name, ModelConfig)
    schema.env.objects = OBJECTS.config_type(cfg.env.objects.name)
    config = OmegaConf.to_object(OmegaConf.merge(schema, values))
    assert isinstance(config, Config)
    validate(config)
    return config


def validate(config: Config) -> None:
    """Check what the types cannot.

    Raises:
        SdfgcnError: One sentence that names the key, the value seen and what would work.
    """
    env = config.env
    if not 1 <= env.n_objects <= env.max_objects:
        raise SdfgcnError(
            f"n_objects is {env.n_objects}, but must lie between 1 and env.max_objects "
            f"({env.max_objects})."
        )
    for key, split in (("eval.split", config.eval.split), ("env.split", env.split)):
        if split not in SPLITS:
            raise SdfgcnError(f"{key} is '{split}', but must be one of {', '.join(SPLITS)}.")
    motions = {f"env.push.{key}": getattr(env.push, key) for key in MOTIONS}
    for key, value in {**motions, "env.robot.acceleration": env.robot.acceleration}.items():
        if value <= 0:
            raise SdfgcnError(f"{key} is {value}, but must be above 0.")
    ticks = env.push.control_timestep / env.physics.timestep
    if not (ticks >= 0.5 and abs(ticks - round(ticks)) < 1e-6):
        raise SdfgcnError(
            f"env.push.control_timestep is {env.push.control_timestep}, but must be a multiple of "
            f"env.physics.timestep ({env.physics.timestep})."
        )
    if not 0 < env.perception.encoder.patch <= 1:
        raise SdfgcnError(
            f"env.perception.encoder.patch is {env.perception.encoder.patch}, but must be above 0 "
            "and at most 1."
        )
    if env.split != config.eval.split:
        raise SdfgcnError(
            f"env.split is '{env.split}' while eval.split is '{config.eval.split}': set eval.split "
            "alone, and env.split follows it."
        )
    for key, value, least in (
        ("seed", config.seed, 0),
        ("eval.episodes", config.eval.episodes, 1),
        ("viz.episodes", config.viz.episodes, 0),
        ("runtime.workers", config.runtime.workers, 0),
        ("runtime.torch_threads", config.runtime.torch_threads, 1),
        ("env.pushes_per_object", env.pushes_per_object, 1),
        ("env.perception.encoder.input_size", env.perception.encoder.input_size, 32),
        ("env.perception.encoder.rotations", env.perception.encoder.rotations, 1),
        ("env.perception.encoder.color_weight", env.perception.encoder.color_weight, 0),
    ):
        if value < least:
            raise SdfgcnError(f"{key} is {value}, but must be at least {least}.")
    validate_model(config.model, env.arena.image_size)
    if config.model.name in MODEL_CONFIGS:
        validate_training(config)


def validate_training(config: Config) -> None:
    """Check what a Q-network's training and evaluation need.

    Raises:
        SdfgcnError: One sentence that names the key, the value seen and what would work.
    """
    train, budget, counts = config.train, config.budget, config.curriculum.counts
    if counts and not (min(counts) >= 1 and max(counts) <= config.env.max_objects):
        raise SdfgcnError(
            f"curriculum.counts is {counts}, but every count must lie between 1 and "
            f"env.max_objects ({config.env.max_objects})."
        )
    for key, name, names in (
        ("train.split", train.split, SPLITS),
        ("train.loss", train.loss, ("smooth_l1", "l2")),
        ("runtime.precision", config.runtime.precision, ("auto", "bfloat16", "float32")),
    ):
        if name not in names:
            raise SdfgcnError(f"{key} is '{name}', but must be one of {', '.join(names)}.")
    for key, value in (
        ("train.discount", train.discount),
        ("train.epsilon_start", train.epsilon_start),
        ("train.epsilon_end", train.epsilon_end),
        ("eval.epsilon", config.eval.epsilon),
        ("augment.probability", config.augment.probability),
        ("curriculum.bar", config.curriculum.bar),
        ("curriculum.newest_share", config.curriculum.newest_share),
    ):
        if not 0.0 <= value <= 1.0:
            raise SdfgcnError(f"{key} is {value}, but must lie between 0 and 1.")
    for key, at_least_one in (
        ("budget.pushes", budget.pushes),
        ("budget.epsilon_pushes", budget.epsilon_pushes),
        ("collector.pushes_per_batch", config.collector.pushes_per_batch),
        ("train.pushes_per_object", train.pushes_per_object),
        ("train.batch_size", train.batch_size),
        ("train.target_interval", train.target_interval),
        ("train.sdf_cache", train.sdf_cache),
        ("train.log_pushes", train.log_pushes),
    ):
        if at_least_one < 1:
            raise SdfgcnError(f"{key} is {at_least_one}, but must be at least 1.")
    if not 0.0 <= train.averaging < 1.0:
        raise SdfgcnError(
            f"train.averaging is {train.averaging}, but must be at least 0 (the last weights) and "
            "below 1."
        )
    _validate_order(
        "train.epsilon_end", train.epsilon_end, "train.epsilon_start", train.epsilon_start
    )
    _validate_order(
        *("train.batch_size", train.batch_size, "train.replay_capacity", train.replay_capacity)
    )
    _validate_order(
        *("train.updates_per_push", train.updates_per_push),
        *("train.max_updates_per_push", train.max_updates_per_push),
    )
    if train.learning_rate <= 0 or train.max_gradient_norm <= 0 or train.updates_per_push < 0:
        raise SdfgcnError(
            f"train.learning_rate is {train.learning_rate}, train.max_gradient_norm is "
            f"{train.max_gradient_norm} and train.updates_per_push is {train.updates_per_push}, "
            "but the first two must be above 0 and the third at least 0."
        )


def _validate_order(lesser: str, low: float, greater: str, high: float) -> None:
    if low > high:
        raise SdfgcnError(f"{lesser} is {low}, but must not be above {greater} ({high}).")


def validate_model(model: ModelConfig, image_size: int) -> None:
    """Check a network's widths against each other and against the picture.

    Args:
        model: The `model` part of the config.
        image_size: Height and width of the picture, pixels.

    Raises:
        SdfgcnError: One sentence that names the key, the value seen and what would work.
    """
    if isinstance(model, PoseGcnConfig):
        _validate_channels("model.channels", model.channels, model.channels)
        _validate_above_zero(hidden=model.hidden, position_unit=model.position_unit)
    if not isinstance(model, ConvModelConfig):
        return
    width = lookup(model.widths, "model.width", model.width)
    key = f"model.widths.{model.width}"
    _validate_channels(f"{key}.channels", width.channels, width.channels)
    _validate_channels(f"{key}.strides", width.strides, width.channels)
    _validate_channels(f"{key}.pooling", [width.pooling], [width.channels])
    _validate_above_zero(
        **{f"widths.{model.width}.hidden": width.hidden, "sdf_unit": model.sdf_unit}
    )
    if conv_sizes(image_size, width.strides, width.pooling)[-1] < 1:
        raise SdfgcnError(
            f"{key}.strides {width.strides} and pooling {width.pooling} leave nothing of a picture "
            f"of env.arena.image_size {image_size}; take smaller ones or a larger picture."
        )


def conv_sizes(image_size: int, strides: list[list[int]], pooling: list[int]) -> list[int]:
    """Height and width of a picture after each CNN block: padded 3x3 convolutions, then pooling."""
    sizes = []
    for block, pool in zip(strides, pooling, strict=True):
        for stride in block:
            image_size = (image_size - 1) // stride + 1
        image_size //= pool
        sizes.append(image_size)
    return sizes


def _validate_channels(key: str, values: list[list[int]], shape: list[list]) -> None:
    """Check for whole numbers of at least 1, in as many lists of the same lengths as `shape`."""
    lengths = [len(block) for block in shape]
    if not values or [len(block) for block in values] != lengths or min(lengths) < 1:
        raise SdfgcnError(
            f"{key} is {values}, but must have an entry for every CNN block and convolution of "
            f"channels, whose lengths are {lengths}."
        )
    if min(min(block) for block in values) < 1:
        raise SdfgcnError(f"{key} is {values}, but every number must be at least 1.")


def _validate_above_zero(**values: float) -> None:
    for key, value in values.items():
        if value <= 0:
            raise SdfgcnError(f"model.{key} is {value}, but must be above 0.")


def validate_train_ucn(config: TrainUCNConfig) -> None:
    """Check what the types cannot say about a training of the segmentation network.

    Raises:
        SdfgcnError: One sentence that names the key, the value seen and what would work.
    """
    scenes = config.scenes
    for key, value, least in (
        ("seed", config.seed, 0),
        ("steps", config.steps, 1),
        ("batch", config.batch, 1),
        ("checkpoint_steps", config.checkpoint_steps, 1),
        ("validation_scenes", config.validation_scenes, 1),
        ("torch_threads", config.torch_threads, 1),
        ("scenes.layouts", scenes.layouts, 1),
        ("scenes.appearances", scenes.appearances, 1),
        ("scenes.workers", scenes.workers, 0),
    ):
        if value < least:
            raise SdfgcnError(f"{key} is {value}, but must be at least {least}.")
    fewest, most = scenes.n_objects
    if not 1 <= fewest <= most:
        raise SdfgcnError(
            f"scenes.n_objects is {scenes.n_objects}, but must be two numbers from 1 on, the "
            "smaller first."
        )
    if not config.catalogues:
        raise SdfgcnError("catalogues is empty, but at least one object catalogue is needed.")
