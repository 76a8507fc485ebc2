"""Shared by the experiments: config, command line and where results go."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from sdfgcn.cli import to_sentence
from sdfgcn.compose import load_config
from sdfgcn.config import Config
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import write_json

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "experiments" / "results"  # tracked: written only when asked
SCRATCH = ROOT / "outputs" / "experiments"
PUBLISH = "--publish"
PUBLISH_HELP = "write to experiments/results, which git tracks, instead of outputs/experiments"


class Arguments(NamedTuple):
    """The command line of an experiment.

    Attributes:
        own: The experiment's own integers.
        overrides: Overrides of the config.
        folder: Where results go.
    """

    own: dict[str, int]
    overrides: list[str]
    folder: Path


def load(overrides: Sequence[str]) -> Config:
    """The config with overrides as on the command line of `sdfgcn`."""
    return load_config(*overrides)


def parse(arguments: Sequence[str], own: dict[str, int], about: str) -> Arguments:
    """Split `key=value` arguments into an experiment's own integers and config overrides.

    Args:
        arguments: The command line; `--help` prints `about` and ends the process.
        own: The experiment's integers with their defaults.
        about: The experiment's docstring.

    Raises:
        SdfgcnError: One of them is no whole number from 0 on, or an option is unknown.
    """
    if {"-h", "--help"} & set(arguments):
        defaults = " ".join(f"{key}={value}" for key, value in own.items())
        print(f"{about.strip()}\n\n  {defaults}\n  {PUBLISH}    {PUBLISH_HELP}")
        print("  Any other KEY=VALUE is an override, as of `sdfgcn`.")
        raise SystemExit(0)
    values, overrides = dict(own), []
    for argument in arguments:
        key, _, value = argument.partition("=")
        if key in own:
            if not value.isdecimal():
                raise SdfgcnError(f"{key} is '{value}', but must be a whole number from 0 on.")
            values[key] = int(value)
        elif argument.startswith("-") and argument != PUBLISH:
            raise SdfgcnError(f"There is no option {argument}; there are --help and {PUBLISH}.")
        elif argument != PUBLISH:
            overrides.append(argument)
    return Arguments(values, overrides, results_folder(PUBLISH in arguments))


def results_folder(publish: bool) -> Path:
    """Where results go: a folder that git ignores, unless they are to be published."""
    return RESULTS if publish else SCRATCH


def run(main: Callable[[], int | None]) -> int:
    """Run an experiment; an error the user can fix is one sentence on stderr, with exit code 1."""
    try:
        return main() or 0
    except Exception as error:
        sentence = to_sentence(error)
        if sentence is None:
            raise
        print(sentence, file=sys.stderr)
        return 1


def file_name(experiment: str, parts: Sequence[str], usual: Collection[str]) -> str:
    """Name a result after its unusual options, so that none overwrites another."""
    return "_".join([experiment, *(part for part in parts if part not in usual)])


def save(folder: Path, name: str, result: dict[str, Any]) -> None:
    """Write `<name>.json` into a folder and print it."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / f"{name}.json", result)
    print(json.dumps(result, indent=2))
    print(f"Wrote {folder / name}.json.", file=sys.stderr)
