"""The root config, and those of evaluation, logging, recordings and processes."""

from __future__ import annotations

from dataclasses import dataclass, field

from omegaconf import MISSING

from sdfgcn.config.base import (
    MAX_SEED,
    SPLITS,
    ComponentConfig,
    fraction,
    matching,
    number,
    one_of,
)
from sdfgcn.config.comparison import ComparisonConfig
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
    seed: int = number(0, MAX_SEED)
    episodes: int = number(1, 1_000_000)
    split: str = one_of(*SPLITS)
    epsilon: float = fraction()
    loop_distance: float | None = number(0, 10, default=None)
    baseline: str | None = None


@dataclass
class LoggerConfig(ComponentConfig):
    """Where running metrics go besides the result files (`conf/logger/`)."""


@dataclass
class VizConfig(ComponentConfig):
    """Recordings (`conf/viz/`)."""

    episodes: int = number(0, 1_000_000)


@dataclass
class RuntimeConfig:
    """Processes and threads (`conf/runtime/`)."""

    name: str = MISSING
    workers: int = number(0, 256)
    torch_threads: int = number(1, 256)
    device: str = matching(r"cpu|cuda(:\d+)?", "cpu, cuda or cuda:NUMBER")
    precision: str = one_of("auto", "bfloat16", "float32")


@dataclass
class Config:
    """The whole experiment, as `sdfgcn --cfg job` prints it."""

    seed: int = number(0, MAX_SEED)
    n_objects: int = number(1, 100)
    checkpoint: str | None = None
    experiment: ComparisonConfig = field(default_factory=ComparisonConfig)
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
