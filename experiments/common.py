"""Shared by the experiments: config, command line and results folder."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

from sdfgcn.compose import load_config
from sdfgcn.config import Config
from sdfgcn.files import write_json

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "experiments" / "results"


def load(overrides: Sequence[str]) -> Config:
    """The config with overrides as on the command line of `sdfgcn`."""
    return load_config(*overrides)


def parse(arguments: Sequence[str], own: dict[str, int]) -> tuple[dict[str, int], list[str]]:
    """Split `key=value` arguments into an experiment's own integers and config overrides."""
    values, overrides = dict(own), []
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key in own:
            values[key] = int(value)
        else:
            overrides.append(argument)
    return values, overrides


def file_name(experiment: str, parts: Sequence[str], usual: Collection[str]) -> str:
    """Name a result after its unusual options, so that none overwrites another."""
    return "_".join([experiment, *(part for part in parts if part not in usual)])


def save(name: str, result: dict[str, Any]) -> None:
    """Write `results/<name>.json` and print it."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    write_json(RESULTS / f"{name}.json", result)
    print(json.dumps(result, indent=2))
