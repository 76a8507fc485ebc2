"""What a comparison consists of: its cells, folders and the overrides of each run."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from sdfgcn.config import BudgetConfig, ComparisonConfig, MethodConfig, lookup
from sdfgcn.errors import SdfgcnError

Cell = Mapping[str, Any]  # overrides by key, such as {"n_objects": 3, "eval": "greedy"}

DONE = "done"  # an empty file in the folder of a finished job


def cells(experiment: ComparisonConfig) -> list[Cell]:
    """Every combination of conditions under which each method is evaluated, in order."""
    return [
        dict(zip(grid, values, strict=True))
        for grid in experiment.cells
        for values in product(*grid.values())
    ]


def cell_name(cell: Cell) -> str:
    """The name of a cell's folder, such as `n_objects=3,eval=greedy`."""
    return ",".join(f"{key}={value}" for key, value in cell.items())


def check(experiment: ComparisonConfig) -> None:
    """Check what an experiment's types cannot.

    Raises:
        SdfgcnError: One sentence that names the key, its value and what would work.
    """
    wanted = experiment.headline.items()
    if not any(wanted <= cell.items() for cell in cells(experiment)):
        raise SdfgcnError(
            f"experiment.headline is {dict(experiment.headline)}, but none of experiment.cells has "
            "all of these values; change one of the two."
        )
    for name in experiment.references:
        lookup(experiment.methods, "experiment.references", name)


@dataclass(frozen=True)
class Plan:
    """The runs of one experiment.

    Attributes:
        experiment: What is compared.
        budget: Sets the number of seeds and how long evaluations are.
        given: The command line's overrides, apart from the experiment, the method and the seed.
    """

    experiment: ComparisonConfig
    budget: BudgetConfig
    given: tuple[str, ...]

    def method(self, name: str | None) -> MethodConfig:
        """The method of a name.

        Raises:
            SdfgcnError: There is no such method.
        """
        return lookup(self.experiment.methods, "experiment.method", str(name))

    def training(self, name: str, seed: int) -> list[str]:
        """The overrides of a method's training."""
        method, experiment = self.method(name), self.experiment
        return [
            *experiment.overrides,
            *experiment.training,
            *method.agent,
            *method.training,
            f"budget={self.budget.name}",
            *self.given,
            f"seed={seed}",
        ]

    def evaluation(self, name: str, seed: int, cell: Cell, policy: Path | None) -> list[str]:
        """The overrides of a method's evaluation in one cell; `policy` is that of its network."""
        experiment = self.experiment
        return [
            *experiment.overrides,
            *self.method(name).agent,
            *experiment.evaluation,
            *(f"{key}={value}" for key, value in cell.items()),
            f"budget={self.budget.name}",
            *self.budget.evaluation,
            *self.given,
            f"seed={seed}",
            *([f"checkpoint={_quoted(policy)}"] if policy is not None else []),
        ]

    def trainings(self, name: str) -> Path:
        """The folder of a method's trainings, one for each seed.

        It is named after what is trained and how, so that experiments share trainings.
        """
        method = self.method(name)
        parts = [*method.agent, *method.training, self.budget.name]
        words = [re.sub(r"\W", "", part.rpartition("=")[2]) for part in parts]
        return Path(self.experiment.trainings) / "_".join(words)


def given(overrides: Sequence[str], experiment: ComparisonConfig) -> tuple[str, ...]:
    """The overrides of a command line that apply to every run of an experiment.

    Raises:
        SdfgcnError: One contradicts the experiment.
    """
    own = {key for cell in cells(experiment) for key in cell} | {
        "model",
        "curriculum",
        "checkpoint",
    }
    kept = []
    for override in overrides:
        key = override.lstrip("+~").partition("=")[0]
        if key == "seed" or key.partition(".")[0] == "experiment":
            continue
        if key in own:
            raise SdfgcnError(
                f"{override} contradicts experiment={experiment.name}, which sets {key} itself; "
                "leave it out, or change experiment.methods or experiment.cells."
            )
        kept.append(override)
    return tuple(kept)


def _quoted(path: Path) -> str:
    """A path as a value of an override."""
    return "'" + str(path).replace("'", r"\'") + "'"
