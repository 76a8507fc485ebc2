"""The text of `sdfgcn --help`, made from the YAML files of `conf/` and their comments."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from sdfgcn.compose import component_dirs, conf_dir

# The keys that a user sets most; all others are in `--cfg job`.
MAIN_KEYS = (
    *("n_objects", "seed", "checkpoint", "eval.episodes", "eval.seed", "eval.split"),
    *("eval.epsilon", "eval.loop_distance", "env.success_threshold", "env.pushes_per_object"),
    *("viz.episodes", "runtime.workers", "budget.pushes", "budget.minutes"),
)
_WIDTH = 100  # characters of a line


def help_text() -> str:
    """Groups and options with a line each, the main keys with their defaults, and examples."""
    root = _read(conf_dir() / "config.yaml")
    frame = root["hydra"]["help"]
    return "\n".join(
        [
            frame["header"].rstrip(),
            "",
            "Groups: pick an option with GROUP=OPTION (* is the default)",
            *_options(_defaults(root)),
            "",
            "Keys: set any with KEY=VALUE; `--cfg job` prints all, with their values",
            *_main_keys(_defaults(root)),
            "",
            frame["footer"].rstrip(),
        ]
    )


def all_keys() -> set[str]:
    """All keys of all options, with dots."""
    keys = set(_keys(_read(conf_dir() / "config.yaml")))
    for file in _option_files():
        keys.update(_keys(_read(file), _prefix(file)))
    return keys


def summary(file: Path) -> str:
    """The first sentence of the comment at the top of an option's YAML file; "" without one."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        if not line.startswith("# @package"):
            lines.append(line[1:].strip())
    return re.split(r"(?<=\.)\s+(?=[A-Z`])", " ".join(lines))[0].rstrip(".")


def _options(defaults: dict[str, str]) -> Iterator[str]:
    """A line for each option of each group, in the order of the default list."""
    files = sorted(_option_files(), key=lambda file: file.stem)
    for group, default in defaults.items():
        head = group
        for file in (file for file in files if file.parent.name == group):
            option = file.stem + ("*" if file.stem == default else "")
            yield _line(f"  {head:<13}{option:<18} ", summary(file))
            head = ""


def _main_keys(defaults: dict[str, str]) -> Iterator[str]:
    """A line for each main key: its default, and the comment on its line."""
    files = [conf_dir() / group / f"{option}.yaml" for group, option in defaults.items()]
    lines: dict[str, tuple[str, str]] = {}
    for file in (conf_dir() / "config.yaml", *files):
        prefix = "" if file.parent == conf_dir() else _prefix(file)
        for line in file.read_text(encoding="utf-8").splitlines():
            if found := re.match(r"(\w+): (\S+)(?: +# *(.*))?", line):
                lines.setdefault(prefix + found[1], (found[2], found[3] or ""))
    for key in MAIN_KEYS:
        value, comment = lines[key]
        yield _line(f"  {key + '=' + value:<32}", comment)


def _line(start: str, text: str) -> str:
    room = _WIDTH - 34
    if len(text) > room:
        text = text.partition(";")[0]
    return f"{start:<34}{textwrap.shorten(text, room, placeholder=' ...')}".rstrip()


def _defaults(root: dict[str, Any]) -> dict[str, str]:
    """The default option of each group, in the order of `conf/config.yaml`."""
    entries = (entry for entry in root["defaults"] if isinstance(entry, dict))
    return {
        group: str(option)
        for entry in entries
        for group, option in entry.items()
        if "@" not in group
    }


def _option_files() -> Iterator[Path]:
    for folder in (conf_dir(), *component_dirs()):
        yield from folder.glob("*/*.yaml")


def _prefix(file: Path) -> str:
    """Where the keys of an option stand in the config, such as "env.robot."."""
    header = re.match(r"# @package (\S+)", file.read_text(encoding="utf-8"))
    package = header[1] if header else file.parent.name
    return "" if package == "_global_" else f"{package}."


def _keys(values: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{key}.")
        elif key != "defaults":
            yield f"{prefix}{key}"


def _read(file: Path) -> dict[str, Any]:
    return yaml.safe_load(file.read_text(encoding="utf-8"))
