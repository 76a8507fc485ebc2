"""The config dataclasses of training."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING

from sdfgcn.config.base import at_least, below_one, fraction, interval, one_of, positive, ranged
from sdfgcn.config.env import EnvConfig, ObjectsConfig


@dataclass
class BudgetConfig:
    """How long a Q-network is trained (`conf/budget/`).

    Attributes:
        seeds: Training seeds of an experiment: 0 and up.
        evaluation: Overrides of every evaluation of an experiment.
    """

    name: str = MISSING
    pushes: int = at_least(1)
    minutes: float | None = at_least(0, default=None)
    epsilon_pushes: int = at_least(1)
    seeds: int = at_least(1)
    evaluation: list[str] = field(default_factory=list)


@dataclass
class CollectorConfig:
    """How pushes are collected while a Q-network learns (`conf/collector/`)."""

    name: str = MISSING
    workers: int = at_least(1, default=1)
    pushes_per_batch: int = at_least(1)


@dataclass
class CurriculumConfig:
    """The number of objects in a training episode (`conf/curriculum/`)."""

    name: str = MISSING
    counts: list[int] = field(default_factory=list)
    window: int = at_least(0, default=0)
    success_threshold: float = fraction(default=0.0)
    confidence: float = ranged(
        lambda value: 0.5 <= value < 1.0, "must be at least 0.5 and below 1", default=0.5
    )
    newest_share: float = fraction(default=0.0)


@dataclass
class HerConfig:
    """Hindsight experience replay (`conf/her/`)."""

    name: str = MISSING
    min_displacement: float = at_least(0, default=0.0)
    per_push: int = at_least(1, default=1)


@dataclass
class AugmentConfig:
    """Augmentation of sampled transitions (`conf/augment/`)."""

    name: str = MISSING
    probability: float = fraction(default=0.0)


@dataclass
class TrainConfig:
    """How a Q-network learns (`conf/train/`)."""

    name: str = MISSING
    discount: float = fraction()
    learning_rate: float = positive()
    loss: str = one_of("smooth_l1", "l2")
    max_gradient_norm: float = positive()
    batch_size: int = at_least(1)
    replay_capacity: int = at_least(1)
    learning_starts: int = at_least(0)
    target_interval: int = at_least(1)
    ema_decay: float = below_one()
    utd_ratio: float = at_least(0)
    max_utd_ratio: float = at_least(0)
    epsilon_start: float = fraction()
    epsilon_end: float = fraction()
    sdf_cache: int = at_least(1)
    log_pushes: int = at_least(1)
    checkpoint_minutes: float = at_least(0)
    eval_pushes: int | None = at_least(1, default=None)
    eval_episodes: int = at_least(1)
    env: EnvConfig = field(default_factory=EnvConfig)


@dataclass
class ArrangementsConfig:
    """The pictures on which a segmenter is trained (`conf/train_segmentation.yaml`)."""

    layouts: int = at_least(1)
    appearances: int = at_least(1)
    n_objects: list[int] = interval(least=1)
    seed: int = at_least(0)
    workers: int = at_least(0)
    touching: float = fraction()
    stacked: float = fraction()
    drop_height: float = at_least(0)
    settle_seconds: float = at_least(0)
    margin: float = MISSING
    plain: float = fraction()
    textured: float = fraction()
    camera_shift: float = at_least(0)
    camera_turn: float = at_least(0)
    fovy: list[float] = interval(least=1)
    lamp_x: list[float] = interval()
    lamp_y: list[float] = interval()
    lamp_z: list[float] = interval()
    lamp_diffuse: list[float] = interval(least=0)
    ambient: list[float] = interval(least=0)
    headlight_diffuse: list[float] = interval(least=0)


@dataclass
class SegmentationTrainingConfig:
    """Training of the segmentation network (`conf/train_segmentation.yaml`)."""

    seed: int = at_least(0)
    n_objects: int = MISSING
    out: str = MISSING
    steps: int = at_least(1)
    batch: int = at_least(1)
    learning_rate: float = positive()
    weight_decay: float = at_least(0)
    warmup: int = at_least(0)
    pull: float = at_least(0)
    push: float = at_least(0)
    torch_threads: int = at_least(1)
    checkpoint_steps: int = at_least(1)
    validation_scenes: int = at_least(1)
    arrangements: ArrangementsConfig = field(default_factory=ArrangementsConfig)
    catalogues: dict[str, ObjectsConfig] = field(default_factory=dict)
    env: EnvConfig = field(default_factory=EnvConfig)
