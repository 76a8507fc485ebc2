"""Every config dataclass: the types behind the YAML files of `conf/`.

The numbers live in YAML. A dataclass here names each key and types it; what a type cannot check,
`sdfgcn/validation.py` does, in sentences. Nothing mutates a config once it is built.
"""

from sdfgcn.config.base import (
    N_DIRECTIONS,
    SPLITS,
    ComponentConfig,
    check_above_zero,
    check_at_least,
    check_choice,
    check_share,
    lookup,
)
from sdfgcn.config.env import (
    ArenaConfig,
    EncoderConfig,
    EnvConfig,
    ObjectsConfig,
    PerceptionConfig,
    PhysicsConfig,
    PushConfig,
    RewardConfig,
    RobotConfig,
    ScenarioConfig,
    SegmentationConfig,
    WorldConfig,
)
from sdfgcn.config.experiment import (
    Config,
    EvalConfig,
    LoggerConfig,
    RuntimeConfig,
    VizConfig,
)
from sdfgcn.config.model import ModelConfig, QNetworkConfig
from sdfgcn.config.train import (
    ArrangementsConfig,
    AugmentConfig,
    BudgetConfig,
    CollectorConfig,
    CurriculumConfig,
    HerConfig,
    SegmentationTrainingConfig,
    TrainConfig,
)

__all__ = [
    "N_DIRECTIONS",
    "SPLITS",
    "ArenaConfig",
    "ArrangementsConfig",
    "AugmentConfig",
    "BudgetConfig",
    "CollectorConfig",
    "ComponentConfig",
    "Config",
    "CurriculumConfig",
    "EncoderConfig",
    "EnvConfig",
    "EvalConfig",
    "HerConfig",
    "LoggerConfig",
    "ModelConfig",
    "ObjectsConfig",
    "PerceptionConfig",
    "PhysicsConfig",
    "PushConfig",
    "QNetworkConfig",
    "RewardConfig",
    "RobotConfig",
    "RuntimeConfig",
    "ScenarioConfig",
    "SegmentationConfig",
    "SegmentationTrainingConfig",
    "TrainConfig",
    "VizConfig",
    "WorldConfig",
    "check_above_zero",
    "check_at_least",
    "check_choice",
    "check_share",
    "lookup",
]
