"""How networks are trained."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING

from sdfgcn.config.env import EnvConfig, ObjectsConfig


@dataclass
class BudgetConfig:
    """How long a Q-network is trained (`conf/budget/`)."""

    name: str = MISSING
    pushes: int = MISSING
    minutes: float | None = None
    epsilon_pushes: int = MISSING


@dataclass
class CollectorConfig:
    """Who pushes while a Q-network learns (`conf/collector/`)."""

    name: str = MISSING
    workers: int = 1
    pushes_per_batch: int = MISSING


@dataclass
class CurriculumConfig:
    """How many objects a training episode has (`conf/curriculum/`)."""

    name: str = MISSING
    counts: list[int] = field(default_factory=list)
    window: int = 0
    success_threshold: float = 0.0
    newest_share: float = 0.0


@dataclass
class HerConfig:
    """Hindsight experience replay (`conf/her/`)."""

    name: str = MISSING
    min_displacement: float = 0.0
    per_push: int = 1


@dataclass
class AugmentConfig:
    """Augmentation of sampled transitions (`conf/augment/`)."""

    name: str = MISSING
    probability: float = 0.0


@dataclass
class TrainConfig:
    """How a Q-network learns (`conf/train/`)."""

    name: str = MISSING
    discount: float = MISSING
    learning_rate: float = MISSING
    loss: str = MISSING
    max_gradient_norm: float = MISSING
    batch_size: int = MISSING
    replay_capacity: int = MISSING
    learning_starts: int = MISSING
    target_interval: int = MISSING
    ema_decay: float = MISSING
    utd_ratio: float = MISSING
    max_utd_ratio: float = MISSING
    epsilon_start: float = MISSING
    epsilon_end: float = MISSING
    sdf_cache: int = MISSING
    log_pushes: int = MISSING
    checkpoint_minutes: float = MISSING
    eval_pushes: int | None = None
    eval_episodes: int = MISSING
    env: EnvConfig = field(default_factory=EnvConfig)


@dataclass
class ArrangementsConfig:
    """The pictures that a segmenter is trained on (`conf/train_segmentation.yaml`)."""

    layouts: int = MISSING
    appearances: int = MISSING
    n_objects: list[int] = MISSING
    seed: int = MISSING
    workers: int = MISSING
    touching: float = MISSING
    stacked: float = MISSING
    drop_height: float = MISSING
    settle_seconds: float = MISSING
    margin: float = MISSING
    plain: float = MISSING
    textured: float = MISSING
    camera_shift: float = MISSING
    camera_turn: float = MISSING
    fovy: list[float] = MISSING
    lamp_x: list[float] = MISSING
    lamp_y: list[float] = MISSING
    lamp_z: list[float] = MISSING
    lamp_diffuse: list[float] = MISSING
    ambient: list[float] = MISSING
    headlight_diffuse: list[float] = MISSING


@dataclass
class SegmentationTrainingConfig:
    """Training of the segmentation network (`conf/train_segmentation.yaml`)."""

    seed: int = MISSING
    n_objects: int = MISSING
    out: str = MISSING
    steps: int = MISSING
    batch: int = MISSING
    learning_rate: float = MISSING
    weight_decay: float = MISSING
    warmup: int = MISSING
    pull: float = MISSING
    push: float = MISSING
    torch_threads: int = MISSING
    checkpoint_steps: int = MISSING
    validation_scenes: int = MISSING
    arrangements: ArrangementsConfig = field(default_factory=ArrangementsConfig)
    catalogues: dict[str, ObjectsConfig] = field(default_factory=dict)
    env: EnvConfig = field(default_factory=EnvConfig)
