"""The config of an experiment that compares methods (`conf/experiment/`)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from omegaconf import MISSING


@dataclass
class MethodConfig:
    """One method of a comparison, as overrides of the command line.

    Attributes:
        agent: What picks the agent, such as `model=sdfgcn`; for training and evaluation.
        training: What only its training needs, such as `curriculum=on`.
    """

    agent: list[str] = MISSING
    training: list[str] = field(default_factory=list)


@dataclass
class ComparisonConfig:
    """Methods, training seeds and cells (`conf/experiment/`).

    Attributes:
        name: The option of `conf/experiment/`, and the name of the result files.
        title: What the table shows, for its heading.
        method: The method of one job of the sweep; a key of `methods`.
        methods: What is compared.
        overrides: Overrides of every training and evaluation.
        training: Overrides of every training.
        evaluation: Overrides of every evaluation.
        trainings: Folder of the trainings, which experiments share.
        cells: The conditions of evaluation: in each entry, every combination of the values of its
            keys is one cell.
        headline: The cells of the main table, as values of keys of `cells`.
        references: Methods that every other one is compared with.
    """

    name: str = MISSING
    title: str = ""
    method: str | None = None
    methods: dict[str, MethodConfig] = field(default_factory=dict)
    overrides: list[str] = field(default_factory=list)
    training: list[str] = field(default_factory=list)
    evaluation: list[str] = field(default_factory=list)
    trainings: str = ""
    cells: list[dict[str, list[Any]]] = field(default_factory=list)
    headline: dict[str, Any] = field(default_factory=dict)
    references: list[str] = field(default_factory=list)
