"""Every config dataclass: the types behind the YAML files of `conf/`.

The numbers live in YAML. A dataclass declares each key with its type and range; relations between
keys are checked by `sdfgcn/validation.py`. A config is never mutated once it is built.
"""

from sdfgcn.config.base import (
    MAX_SEED,
    SPLITS,
    ComponentConfig,
    at_least,
    below_one,
    check_ranges,
    colour,
    colours,
    fraction,
    interval,
    lookup,
    matching,
    number,
    one_of,
    positive,
    range_text,
    ranged,
    rising,
    several,
    vector,
)
from sdfgcn.config.comparison import ComparisonConfig, MethodConfig
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
