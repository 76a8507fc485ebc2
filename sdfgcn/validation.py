"""From Hydra's config to checked dataclasses: what the types in `sdfgcn/config.py` cannot say."""

from __future__ import annotations

from omegaconf import DictConfig, OmegaConf

from sdfgcn.config import SPLITS, Config, ObjectsConfig, TrainUCNConfig
from sdfgcn.errors import SdfgcnError


def typed(cfg: DictConfig) -> Config:
    """Turn Hydra's config into dataclasses and validate it.

    Raises:
        SdfgcnError: A value is out of its range or contradicts another.
        OmegaConfBaseException: A key is unknown, a value is missing or an interpolation leads
            nowhere.
    """
    # Hydra's `+key=value` may have added a key that no dataclass has: merging refuses it.
    values = OmegaConf.to_container(cfg, resolve=True)
    config = OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(Config), values))
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
    ticks = env.push.control_timestep / env.physics.timestep
    if not (ticks >= 0.5 and abs(ticks - round(ticks)) < 1e-6):
        raise SdfgcnError(
            f"env.push.control_timestep is {env.push.control_timestep}, but must be a multiple of "
            f"env.physics.timestep ({env.physics.timestep})."
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
    ):
        if value < least:
            raise SdfgcnError(f"{key} is {value}, but must be at least {least}.")


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
