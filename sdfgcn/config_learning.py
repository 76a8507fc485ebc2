"""The config dataclasses of a training's parts; `sdfgcn/config.py` has the others."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING


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
    workers: int = MISSING
    pushes_per_batch: int = MISSING


@dataclass
class CurriculumConfig:
    """How many objects a training episode has (`conf/curriculum/`)."""

    name: str = MISSING
    counts: list[int] = field(default_factory=list)
    window: int = 0
    bar: float = 0.0
    newest_share: float = 0.0


@dataclass
class HerConfig:
    """Hindsight experience replay (`conf/her/`)."""

    name: str = MISSING
    moved: float = 0.0
    per_push: int = 0


@dataclass
class AugmentConfig:
    """Augmentation of sampled transitions (`conf/augment/`)."""

    name: str = MISSING
    probability: float = 0.0
