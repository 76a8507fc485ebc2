"""From Hydra's config to checked dataclasses: what the types in `sdfgcn/config/` cannot say."""

from __future__ import annotations

from omegaconf import DictConfig, OmegaConf

from sdfgcn.config import (
    SPLITS,
    Config,
    ObjectsConfig,
    QNetworkConfig,
    TrainUCNConfig,
)
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import MODELS

MOTIONS = ("length", "speed", "acceleration", "descent_speed", "lift_speed")  # of env.push


def typed(cfg: DictConfig) -> Config:
    """Turn Hydra's config into dataclasses and validate it.

    Raises:
        SdfgcnError: There is no such model, or a value is out of its range or contradicts
            another.
        OmegaConfBaseException: A key is unknown, a value is missing or an interpolation leads
            nowhere.
    """
    # Hydra's `+key=value` may have added a key that no dataclass has: merging refuses it.
    values = OmegaConf.to_container(cfg, resolve=True)
    schema = OmegaConf.structured(Config)
    schema.model = MODELS.config_type(cfg.model.name)
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
    config.model.check(config)
    if isinstance(config.model, QNetworkConfig):
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


def validate_objects(objects: ObjectsConfig) -> None:
    """Check the object catalogue's limits against each other.

    Raises:
        SdfgcnError: One sentence that names the key, the value seen and what would work.
    """
    for low, high in (("footprint_min", "footprint_max"), ("mass_min", "mass_max")):
        smallest, largest = getattr(objects, low), getattr(objects, high)
        if not 0 < smallest < largest:
            raise SdfgcnError(
                f"env.objects.{low} is {smallest} and env.objects.{high} is {largest}, but the "
                f"first must be above 0 and below the second."
            )
    for key in ("height_max", "thickness_min", "density", "settle_seconds", "settle_speed"):
        if getattr(objects, key) <= 0:
            raise SdfgcnError(f"env.objects.{key} is {getattr(objects, key)}, but must be above 0.")
    smallest_counts = {
        "max_faces": 100,
        "max_pieces": 1,
        "max_piece_vertices": 8,
        "texture_size": 1,
        "settle_drops": 1,
    }
    for key, least in smallest_counts.items():
        if getattr(objects, key) < least:
            raise SdfgcnError(
                f"env.objects.{key} is {getattr(objects, key)}, but must be at least {least}."
            )
    if not 0 <= objects.settle_min_probability < 1:
        raise SdfgcnError(
            f"env.objects.settle_min_probability is {objects.settle_min_probability}, but must be "
            "at least 0 and below 1."
        )
    if len(objects.settle_friction) != 3:
        raise SdfgcnError(
            f"env.objects.settle_friction is {objects.settle_friction}, but must hold three "
            "numbers: sliding, torsional and rolling friction."
        )
    if not objects.palette or any(
        len(colour) != 3 or not all(0 <= part <= 1 for part in colour) for colour in objects.palette
    ):
        raise SdfgcnError(
            f"env.objects.palette is {objects.palette}, but must list colours of three numbers "
            "between 0 and 1 (red, green, blue)."
        )


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
