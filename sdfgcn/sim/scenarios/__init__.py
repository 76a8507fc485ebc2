"""Scenarios: one registry entry per option of the config group `scenario`."""

from sdfgcn.sim.scenarios.circle import Circle
from sdfgcn.sim.scenarios.line import Line
from sdfgcn.sim.scenarios.random import Random
from sdfgcn.sim.scenarios.scenario import Scenario, Situation
from sdfgcn.sim.scenarios.sort import Sort
from sdfgcn.sim.scenarios.swap import Swap

SCENARIOS: dict[str, type[Scenario]] = {
    "random": Random,
    "swap": Swap,
    "line": Line,
    "circle": Circle,
    "sort": Sort,
}

__all__ = ["SCENARIOS", "Scenario", "Situation"]
