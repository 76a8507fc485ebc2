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
    experiment: ComparisonConfig,
    folder: Path,
    methods: Sequence[str],
    seeds: Sequence[int],
    partial: bool = False,
) -> list[Result]:
    """Read all cells of the given methods and seeds; a method without a network has seed 0 only.

    Args:
        experiment: What is compared.
        folder: The sweep's folder.
        methods: Keys of the experiment's methods.
        seeds: The training seeds.
        partial: Leave out cells that some method or seed has not finished.

    Raises:
        SdfgcnError: A cell is missing, unfinished or damaged, or runs do not belong together.
    """
    for name in methods:
        lookup(experiment.methods, "experiment.method", name)
    found = []
    for cell in cells(experiment):
        runs = {name: _runs(folder, name, cell, seeds) for name in methods}
        unfinished = [
            (path, state)
            for paths in runs.values()
            for path in paths
            if (state := _state(path)) != "done"
        ]
        if unfinished and not partial:
            path, state = unfinished[0]
            raise SdfgcnError(
                f"{path} is {state}, so the table would lack it; run the same command again to "
                "finish it, or ask for less with seed=... or experiment.method=..."
            )
        if not unfinished:
            here = [_result(name, cell, paths) for name, paths in runs.items()]
            _check_conditions(folder, here)
            found += here
    _check_commit(found)
    _check_training(found)
    return found


def _runs(folder: Path, method: str, cell: Cell, seeds: Sequence[int]) -> list[Path]:
    """The run folder of each seed; of seed 0 alone for a method without a network."""
    first = folder / method / "seed_0" / cell_name(cell)
    if _state(first) == "done" and _results(first)["checkpoint"] is None:
        return [first]
    return [folder / method / f"seed_{seed}" / cell_name(cell) for seed in seeds]


def _result(method: str, cell: Cell, paths: Sequence[Path]) -> Result:
    runs = [_results(path) for path in paths]
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
    seeds = tuple(int(path.parent.name.removeprefix("seed_")) for path in paths)
    return Result(method, cell, seeds, outcomes, float(out_of_range), tuple(runs))


def _state(path: Path) -> str:
    """The state of a run folder: `done`, `running`, `failed` or `missing`."""
    if not (path / "status.json").exists():
        return "missing"
    return str(_json(path / "status.json").get("state"))


def _results(path: Path) -> dict[str, Any]:
    """The `results.json` of a finished run."""
    return _json(path / "results.json")


def _json(file: Path) -> dict[str, Any]:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SdfgcnError(
            f"{file.parent} is damaged ({error}); remove it and run the experiment again."
        ) from error


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
