"""The whole experiment."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING

from sdfgcn.config.base import ComponentConfig
from sdfgcn.config.env import EnvConfig
from sdfgcn.config.model import ModelConfig
from sdfgcn.config.train import (
    AugmentConfig,
    BudgetConfig,
    CollectorConfig,
    CurriculumConfig,
    HerConfig,
    TrainConfig,
)


@dataclass
class EvalConfig:
    """How a method is evaluated (`conf/eval/`)."""

    name: str = MISSING
    seed: int = MISSING
    episodes: int = MISSING
    split: str = MISSING
    epsilon: float = MISSING
    loop_distance: float | None = None


@dataclass
class LoggerConfig(ComponentConfig):
    """Where running figures go besides the result files (`conf/logger/`)."""


@dataclass
class VizConfig(ComponentConfig):
    """Recordings (`conf/viz/`)."""

    episodes: int = MISSING


@dataclass
class RuntimeConfig:
    """Processes and threads (`conf/runtime/`)."""

    name: str = MISSING
    workers: int = MISSING
    torch_threads: int = MISSING
    device: str = MISSING
    precision: str = MISSING


@dataclass
class Config:
    """The whole experiment, as `sdfgcn --cfg job` prints it."""

    seed: int = MISSING
    n_objects: int = MISSING
    checkpoint: str | None = None
    env: EnvConfig = field(default_factory=EnvConfig)
    model: ModelConfig = field(default_factory=ModelConfig)
    train: TrainConfig = field(default_factory=TrainConfig)
    budget: BudgetConfig = field(default_factory=BudgetConfig)
    collector: CollectorConfig = field(default_factory=CollectorConfig)
    curriculum: CurriculumConfig = field(default_factory=CurriculumConfig)
    her: HerConfig = field(default_factory=HerConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    eval: EvalConfig = field(default_factory=EvalConfig)
    logger: LoggerConfig = field(default_factory=LoggerConfig)
    viz: VizConfig = field(default_factory=VizConfig)
    runtime: RuntimeConfig = field(default_factory=RuntimeConfig)
