"""The finished cells of a comparison, checked to belong together."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from sdfgcn.comparison.plan import Cell, cell_name, cells
from sdfgcn.config import ComparisonConfig, lookup
from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.bootstrap import Outcomes
from sdfgcn.evaluation.episodes import EpisodeTable

# Parts of the config that must be the same for all methods and seeds in a cell.
_CONDITIONS = ("env.", "eval.", "n_objects")
# Parts of a policy's training that must be the same for all methods with a network.
_METHOD_S_OWN = ("model.", "curriculum.", "seed", "train.env.max_objects")


@dataclass(frozen=True)
class Result:
    """One method in one cell.

    Attributes:
        method: A key of the experiment's methods.
        cell: The conditions.
        seeds: The training seeds, the rows of `outcomes`.
        outcomes: How the episodes ended.
        out_of_range_rate: Share of episodes in which an object left the allowed region.
        runs: The `results.json` of each seed.
    """

    method: str
    cell: Cell
    seeds: tuple[int, ...]
    outcomes: Outcomes
    out_of_range_rate: float
    runs: tuple[Mapping[str, Any], ...]


def read(
    experiment: ComparisonConfig, folder: Path, methods: Sequence[str], seeds: Sequence[int]
) -> list[Result]:
    """Read all cells of the given methods and seeds; a method without a network has seed 0 only.

    Raises:
        SdfgcnError: A cell is missing, unfinished or damaged, or runs do not belong together.
    """
    found = [
        _result(folder, name, cell, seeds)
        for name in methods
        if lookup(experiment.methods, "experiment.method", name)
        for cell in cells(experiment)
    ]
    _check_commit(found)
    for cell in cells(experiment):
        _check_conditions(folder, [result for result in found if result.cell == cell])
    _check_training(found)
    return found


def _result(folder: Path, method: str, cell: Cell, seeds: Sequence[int]) -> Result:
    own = list(seeds)
    if (path := folder / method / "seed_0" / cell_name(cell)).exists():
        own = [0] if _finished(path)["checkpoint"] is None else own
    paths = [folder / method / f"seed_{seed}" / cell_name(cell) for seed in own]
    runs = [_finished(path) for path in paths]
    episodes = [EpisodeTable(path / "episodes.csv").read() for path in paths]
    for path, run, rows in zip(paths, runs, episodes, strict=True):
        if [row.seed for row in rows] != run["episode_seeds"]:
            raise SdfgcnError(
                f"{path} holds {len(rows)} episodes, but its results.json was made from "
                f"{run['episodes']}; remove the folder and run the experiment again."
            )
        if run["episode_seeds"] != runs[0]["episode_seeds"]:
            raise SdfgcnError(
                f"{path} has {run['episodes']} episodes of other scenes than {paths[0]} "
                f"({runs[0]['episodes']}); give all the same eval.seed and eval.episodes."
            )
    config: Any = OmegaConf.load(paths[0] / "config.yaml")
    outcomes = Outcomes(
        success=np.array([[row.success for row in rows] for rows in episodes]),
        pushes=np.array([[row.pushes for row in rows] for rows in episodes]),
        # Without a matched object there is no error; it counts in no mean, as it was no success.
        error_mm=np.nan_to_num([[row.error_mm for row in rows] for rows in episodes]),
        limit=config.env.pushes_per_object * config.env.n_objects,
    )
    out_of_range = np.mean([[row.out_of_range for row in rows] for rows in episodes])
    return Result(method, cell, tuple(own), outcomes, float(out_of_range), tuple(runs))


def _finished(path: Path) -> dict[str, Any]:
    """The `results.json` of a finished cell."""
    try:
        status = json.loads((path / "status.json").read_text(encoding="utf-8"))
        state = status.get("state")
        if state == "done":
            return json.loads((path / "results.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        state = "missing"
    except ValueError as error:
        raise SdfgcnError(
            f"{path} is damaged ({error}); remove it and run the experiment again."
        ) from error
    raise SdfgcnError(
        f"{path} is {state}, so the table would lack it; run the same command again to finish it, "
        "or ask for less with seed=... or experiment.method=..."
    )


def _pairs(results: Sequence[Result]) -> Iterator[tuple[Result, int, Mapping[str, Any]]]:
    for result in results:
        for seed, run in zip(result.seeds, result.runs, strict=True):
            yield result, seed, run


def _check_commit(results: Sequence[Result]) -> None:
    commits: dict[str | None, str] = {}
    for result, seed, run in _pairs(results):
        commits.setdefault((run["git"] or {}).get("commit"), f"{result.method} seed {seed}")
    if len(commits) > 1:
        (one, first), (other, second) = list(commits.items())[:2]
        raise SdfgcnError(
            f"{first} was evaluated at commit {one} and {second} at {other}; remove the folders of "
            "one of them and run the experiment again."
        )


def _check_conditions(folder: Path, results: Sequence[Result]) -> None:
    """All methods and seeds in one cell must have faced the same task."""
    first: tuple[str, dict[str, Any]] | None = None
    for result, seed, _ in _pairs(results):
        path = folder / result.method / f"seed_{seed}" / cell_name(result.cell)
        values: Any = OmegaConf.to_container(OmegaConf.load(path / "config.yaml"))
        told = {key: v for key, v in flat(values).items() if key.startswith(_CONDITIONS)}
        first = first or (str(path), told)
        if differing := differences(first[1], told):
            raise SdfgcnError(
                f"{path} is not comparable with {first[0]}, as they differ in {differing}; remove "
                "one of them and run the experiment again."
            )


def _check_training(results: Sequence[Result]) -> None:
    """All networks must have had the same training, apart from what makes the method."""
    first: tuple[str, dict[str, Any]] | None = None
    for result, seed, run in _pairs(results):
        if run.get("training") is None:
            continue
        about = run["training"]
        told = {
            **{f"budget.{key}": value for key, value in (about["budget"] or {}).items()},
            **{f"spent.{key}": about["spent"][key] for key in ("pushes", "updates")},
            **about["training"],
        }
        told = {key: value for key, value in told.items() if not key.startswith(_METHOD_S_OWN)}
        first = first or (f"{result.method} seed {seed}", told)
        if differing := differences(first[1], told):
            raise SdfgcnError(
                f"{result.method} seed {seed} was not trained as {first[0]} was: they differ in "
                f"{differing}; train both alike."
            )
