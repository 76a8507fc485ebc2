"""The config dataclasses of training."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING

from sdfgcn.config.base import (
    MAX_SEED,
    below_one,
    fraction,
    interval,
    number,
    one_of,
    positive,
    rising,
)
from sdfgcn.config.env import EnvConfig, ObjectsConfig


@dataclass
class BudgetConfig:
    """How long a Q-network is trained (`conf/budget/`).

    Attributes:
        seeds: Training seeds of an experiment: 0 and up.
        evaluation: Overrides of every evaluation of an experiment.
    """

    name: str = MISSING
    pushes: int = number(1, 1_000_000_000)
    minutes: float | None = positive(1_000_000, default=None)
    epsilon_pushes: int = number(1, 1_000_000_000)
    seeds: int = number(1, 1000)
    evaluation: list[str] = field(default_factory=list)


@dataclass
class CollectorConfig:
    """How pushes are collected while a Q-network learns (`conf/collector/`)."""

    name: str = one_of("sync", "async")
    workers: int = number(1, 256, default=1)
    pushes_per_batch: int = number(1, 1000)


@dataclass
class CurriculumConfig:
    """The number of objects in a training episode (`conf/curriculum/`)."""

    name: str = MISSING
    counts: list[int] = rising(1, 100, default=[])
    window: int = number(0, 1_000_000, default=0)
    success_threshold: float = fraction(default=0.0)
    confidence: float = number(0.5, below=1, default=0.5)
    newest_share: float = fraction(default=0.0)


@dataclass
class HerConfig:
    """Hindsight experience replay (`conf/her/`)."""

    name: str = one_of("off", "next", "future")
    min_displacement: float = number(0, 1, default=0.0)
    per_push: int = number(1, 100, default=1)


@dataclass
class AugmentConfig:
    """Augmentation of sampled transitions (`conf/augment/`)."""

    name: str = one_of("off", "mirror")
    probability: float = fraction(default=0.0)


@dataclass
class TrainConfig:
    """How a Q-network learns (`conf/train/`)."""

    name: str = MISSING
    discount: float = fraction()
    learning_rate: float = positive(10)
    loss: str = one_of("smooth_l1", "l2")
    max_gradient_norm: float = positive(1_000_000)
    batch_size: int = number(1, 4096)
    replay_capacity: int = number(1, 1_000_000)
    learning_starts: int = number(0, 1_000_000_000)
    target_interval: int = number(1, 1_000_000_000)
    ema_decay: float = below_one()
    utd_ratio: float = number(0, 100)
    max_utd_ratio: float = number(0, 100)
    epsilon_start: float = fraction()
    epsilon_end: float = fraction()
    sdf_cache: int = number(1, 1_000_000)
    log_pushes: int = number(1, 1_000_000_000)
    checkpoint_minutes: float = number(0, 1_000_000)
    eval_pushes: int | None = number(1, 1_000_000_000, default=None)
    eval_episodes: int = number(1, 10_000)
    env: EnvConfig = field(default_factory=EnvConfig)


@dataclass
class ArrangementsConfig:
    """The pictures on which a segmenter is trained (`conf/train_segmentation.yaml`)."""

    layouts: int = number(1, 1_000_000)
    appearances: int = number(1, 1000)
    n_objects: list[int] = interval(1, 100, empty=True)
    seed: int = number(0, MAX_SEED)
    workers: int = number(0, 256)
    touching: float = fraction()
    stacked: float = fraction()
    drop_height: float = number(0, 1)
    settle_seconds: float = number(0, 60)
    margin: float = number(0, 1)
    plain: float = fraction()
    textured: float = fraction()
    camera_shift: float = number(0, 1)
    camera_turn: float = number(0, 90)
    fovy: list[float] = interval(1, 150, empty=True)
    lamp_x: list[float] = interval(-10, 10, empty=True)
    lamp_y: list[float] = interval(-10, 10, empty=True)
    lamp_z: list[float] = interval(0, 10, empty=True)
    lamp_diffuse: list[float] = interval(0, 1, empty=True)
    ambient: list[float] = interval(0, 1, empty=True)
    headlight_diffuse: list[float] = interval(0, 1, empty=True)


@dataclass
class SegmentationTrainingConfig:
    """Training of the segmentation network (`conf/train_segmentation.yaml`)."""

    seed: int = number(0, MAX_SEED)
    n_objects: int = number(1, 100)
    out: str = MISSING
    steps: int = number(1, 1_000_000_000)
    batch: int = number(1, 4096)
    learning_rate: float = positive(10)
    weight_decay: float = number(0, 10)
    warmup: int = number(0, 1_000_000_000)
    pull: float = number(0, 2)
    push: float = number(0, 2)
    torch_threads: int = number(1, 256)
    checkpoint_steps: int = number(1, 1_000_000_000)
    validation_scenes: int = number(1, 10_000)
    arrangements: ArrangementsConfig = field(default_factory=ArrangementsConfig)
    catalogues: dict[str, ObjectsConfig] = field(default_factory=dict)
    env: EnvConfig = field(default_factory=EnvConfig)
