"""The real config of `conf/`, with overrides."""

from functools import cache
from pathlib import Path

from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from sdfgcn.config import Config, register_schema
from sdfgcn.validation import typed

CONF = Path(__file__).parents[1] / "conf"


@cache  # nothing mutates a config
def compose_config(*overrides: str) -> DictConfig:
    """What `run.py` gets from Hydra."""
    register_schema()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("config", list(overrides))


@cache
def real_config(*overrides: str) -> Config:
    """The same as checked dataclasses."""
    return typed(compose_config(*overrides))
