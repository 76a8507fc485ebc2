"""The options of `conf/perception/`."""

from __future__ import annotations

from collections.abc import Callable

from sdfgcn.config import PerceptionConfig
from sdfgcn.perception.oracle import OraclePerception
from sdfgcn.perception.perception import Perception
from sdfgcn.perception.vision import VisionPerception

PERCEPTIONS: dict[str, Callable[[PerceptionConfig, int], Perception]] = {
    "oracle": OraclePerception,
    "vision": VisionPerception,
}
