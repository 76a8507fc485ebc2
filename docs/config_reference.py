"""The config reference: every key of `conf/` with its default, its range and its own comment.

    python docs/config_reference.py        prints it as Markdown

Values and comments come from the YAML files, ranges from the fields of the config dataclasses, so
nothing is written twice. `docs/conf.py` puts the text into `config_reference.md` at build time.
"""

from __future__ import annotations

import dataclasses
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from sdfgcn.compose import conf_dir
from sdfgcn.config import Config, SegmentationTrainingConfig
from sdfgcn.registry import REGISTRIES

ROOTS = {
    "config": Config,
    "compare": Config,
    "train_segmentation": SegmentationTrainingConfig,
}
TITLES = {
    "config": "Keys without a group",
    "compare": "Keys that `python -m sdfgcn.compare` sets",
    "train_segmentation": "Training of the segmentation network",
}
NO_KEYS = ("defaults", "hydra.help")  # Hydra's list of options, and the text of `--help`


@dataclass(frozen=True)
class Key:
    """One key of a YAML file.

    Attributes:
        path: Where it sits in the composed config, with dots.
        value: Its value as the file has it; empty for a key that only holds others.
        comment: Its comment: what stands on its line, then what stands above it.
        range: The values that it may have, such as "must be above 0"; empty if any will do.
    """

    path: str
    value: str
    comment: str
    range: str


@dataclass(frozen=True)
class Option:
    """One YAML file: an option of a group, or a root config.

    Attributes:
        name: The file's name without `.yaml`.
        about: The comment at its top.
        picks: The options of other groups that it picks, as overrides.
        keys: Its keys by path, with those of the options that it extends.
    """

    name: str
    about: str
    picks: tuple[str, ...]
    keys: dict[str, Key]


def text() -> str:
    """The whole reference as Markdown with definition lists."""
    defaults = _entries(conf_dir() / "config.yaml")
    parts = [_section(TITLES["config"], [read(conf_dir() / "config.yaml")])]
    for group in (name for name in defaults if "@" not in name):
        parts.append(_section(f"`{group}`", options(group), defaults[group], _elsewhere(group)))
    root = read(conf_dir() / "train_segmentation.yaml")
    compared = _section(TITLES["compare"], [read(conf_dir() / "compare.yaml")])
    return "\n".join([*parts, compared, _section(TITLES["train_segmentation"], [root])])


# ---------------------------------------------------------------------- reading


def options(group: str) -> list[Option]:
    """Every option of a group."""
    return [read(file) for file in sorted((conf_dir() / group).glob("*.yaml"))]


def read(file: Path) -> Option:
    """Read one YAML file and the options that it extends."""
    text = file.read_text(encoding="utf-8")
    header = re.match(r"# @package (\S+)\n", text)
    package = "" if file.parent == conf_dir() else file.parent.name
    if header:
        package = "" if header[1] == "_global_" else header[1]
    about = _comment_block(text.splitlines(), 1 if header else 0)
    keys: dict[str, Key] = {}
    for base in _bases(file):
        keys |= read(base).keys
    for path, value, comment in _keys(text, package):
        if path.endswith("name") and value.strip('"') == file.stem:
            continue  # the name of the option, which its heading already says
        inherited = keys[path].comment if path in keys else ""
        keys[path] = Key(path, value, comment or inherited, _range(path, file))
    picks = [f"{_group(key)}={option}" for key, option in _entries(file).items() if "/" in key]
    return Option(file.stem, about, tuple(picks), keys)


def _keys(text: str, prefix: str) -> Iterator[tuple[str, str, str]]:
    """Path, value and comment of every key of a YAML text, apart from `NO_KEYS`."""
    lines = text.splitlines()
    root = yaml.compose(text)

    def walk(node: yaml.MappingNode, prefix: str) -> Iterator[tuple[str, str, str]]:
        for key, value in node.value:
            path = f"{prefix}.{key.value}".removeprefix(".")
            if path.endswith(NO_KEYS):
                continue
            holds_keys = isinstance(value, yaml.MappingNode) and not value.flow_style
            comment = _comment(lines, key, value)
            if not holds_keys:
                yield path, _source(text, value), comment
            else:
                if comment:
                    yield path, "", comment
                yield from walk(value, path)

    yield from walk(root, prefix)


def _source(text: str, node: yaml.Node) -> str:
    """A value as it is written; the items of a block list in brackets."""
    if isinstance(node, yaml.SequenceNode) and not node.flow_style:
        return f"[{', '.join(_source(text, item) for item in node.value)}]"
    if isinstance(node, yaml.MappingNode) and not node.flow_style:
        pairs = (f"{key.value}: {_source(text, value)}" for key, value in node.value)
        return f"{{{', '.join(pairs)}}}"
    return " ".join(text[node.start_mark.index : node.end_mark.index].split())


def _comment(lines: list[str], key: yaml.Node, value: yaml.Node) -> str:
    """The comment on a key's line, those on the lines of its list, and the block above it."""
    block = isinstance(value, yaml.CollectionNode) and not value.flow_style
    mark = key.end_mark if block else value.end_mark
    parts = [_trailing(lines[mark.line][mark.column :])]
    if block and isinstance(value, yaml.SequenceNode):
        ends = [item.end_mark for item in value.value]
        items = [_trailing(lines[end.line][end.column :]) for end in ends]
        parts.append(", ".join(dict.fromkeys(filter(None, items))))
    first = key.start_mark.line
    while first > 0 and lines[first - 1].lstrip().startswith("#"):
        first -= 1
    if first > 0:  # at the top of the file it is about the option
        parts.append(_comment_block(lines, first))
    return ". ".join(part.removesuffix(".") for part in parts if part)


def _trailing(rest: str) -> str:
    found = re.match(r"[:\s,\]}]*#\s*(.*)", rest)
    return found[1].strip() if found else ""


def _comment_block(lines: list[str], first: int) -> str:
    """The comment lines from `first` on as one text."""
    last = first
    while last < len(lines) and lines[last].lstrip().startswith("#"):
        last += 1
    return " ".join(line.lstrip().lstrip("#").strip() for line in lines[first:last])


def _entries(file: Path) -> dict[str, str]:
    """The entries of a file's defaults list that pick an option of a group."""
    entries = yaml.safe_load(file.read_text(encoding="utf-8")).get("defaults", [])
    return {key: entry[key] for entry in entries if isinstance(entry, dict) for key in entry}


def _bases(file: Path) -> list[Path]:
    """The options of its own group that a file extends."""
    entries = yaml.safe_load(file.read_text(encoding="utf-8")).get("defaults", [])
    names = [entry.partition("@")[0] for entry in entries if isinstance(entry, str)]
    return [file.with_name(f"{name}.yaml") for name in names if name != "_self_"]


def _group(key: str) -> str:
    """The group of an entry such as `override /train@_global_.train`."""
    return key.removeprefix("override ").strip().lstrip("/").partition("@")[0]


def _elsewhere(group: str) -> str:
    """What a second use of a group in `config.yaml` is called, with its default."""
    for key, option in _entries(conf_dir() / "config.yaml").items():
        if key.startswith(f"{group}@"):
            return f"`{key}=...` picks another one for that key, by default `{option}`."
    return ""


def _range(path: str, file: Path) -> str:
    """The range of a key, from the metadata of its field; empty if it has none."""
    kind: Any = ROOTS.get(file.stem, Config)
    picked = {
        registry.path: registry.config_type(file.stem)
        for registry in REGISTRIES
        if registry.group == file.parent.name
    }
    words, parts = "", path.split(".")
    for end, part in enumerate(parts, start=1):
        if typing.get_origin(kind) is dict:
            kind, words = typing.get_args(kind)[1], ""
            continue
        field = dataclasses.is_dataclass(kind) and kind.__dataclass_fields__.get(part)
        if not field:
            return ""
        words = getattr(field.metadata.get("range"), "words", "")
        kind = picked.get(".".join(parts[:end]), typing.get_type_hints(kind)[part])
    return words


# ---------------------------------------------------------------------- writing


def _section(title: str, found: list[Option], default: str = "", more: str = "") -> str:
    lines = [f"## {title}", ""]
    lines += [_about(option, default) for option in found] if default else [found[0].about]
    lines += ["", more, ""] if more else [""]
    for path in dict.fromkeys(path for option in found for path in option.keys):
        lines += [*_definition(path, found), ""]
    return "\n".join(lines)


def _about(option: Option, default: str) -> str:
    mark = " (default)" if option.name == default else ""
    picks = f" Picks {', '.join(f'`{pick}`' for pick in option.picks)}." if option.picks else ""
    return f"- **`{option.name}`**{mark}: {option.about}{picks}"


def _definition(path: str, found: list[Option]) -> list[str]:
    """A key as an entry of a definition list; where options differ, a line for each value."""
    variants: dict[tuple[str, str], list[str]] = {}
    for option in found:
        if key := option.keys.get(path):
            variants.setdefault((key.value, _meaning(key)), []).append(f"`{option.name}`")
    (value, meaning), names = next(iter(variants.items()))
    if meaning and len(names) == len(found):
        return [f"`{path}`" + (f" = `{value}`" if value else ""), f": {meaning}"]
    shared = len({meaning for _, meaning in variants}) == 1
    lines = [f"`{path}`"]
    for (value, own), names in variants.items():
        names = [] if len(names) == len(found) else [", ".join(names)]
        values = [f"`{value}`"] if value else []
        lines += [f": {': '.join([*names, *values, *([own] if own and not shared else [])])}"]
    return [*lines, f": {meaning}"] if shared and meaning else lines


def _meaning(key: Key) -> str:
    """The comment and the range of a key, as sentences."""
    comment = f"{key.comment}." if key.comment else ""
    allowed = f"*{key.range[0].upper()}{key.range[1:]}.*" if key.range else ""
    return " ".join(filter(None, [comment, allowed]))


if __name__ == "__main__":
    print(text(), end="")
