"""The real config of `conf/`, with overrides."""

from functools import cache

from omegaconf import DictConfig

from sdfgcn import compose
from sdfgcn.config import Config

CONF = compose.conf_dir()


@cache  # nothing mutates a config
def compose_config(*overrides: str) -> DictConfig:
    """What the command line gets from Hydra."""
    return compose.compose_config(overrides)


@cache
def real_config(*overrides: str) -> Config:
    """The same as checked dataclasses."""
    return compose.load_config(*overrides)
