"""The README and the manual: commands, links, files and figures that they name are there."""

from __future__ import annotations

import json
import re
import shlex
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml
from configs import CONF, compose_config
from hydra.core.override_parser.overrides_parser import OverridesParser

from sdfgcn.evaluation.report import text as report

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))

import config_reference  # noqa: E402

CARDS = [*ROOT.glob("sdfgcn/weights/*/README.md"), ROOT / "sdfgcn/perception/weights/ucn.md"]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXTS = {path: path.read_text(encoding="utf-8") for path in (*PAGES, *CARDS)}
YAMLS = sorted(CONF.rglob("*.yaml"))


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


# ---------------------------------------------------------------------- config reference


@pytest.fixture(scope="module")
def reference() -> str:
    return config_reference.text()


def keys(values: dict[str, Any], prefix: str) -> Iterator[str]:
    """The dotted keys of a YAML file that hold a value."""
    for key, value in values.items():
        if isinstance(value, dict) and not key.startswith("headline"):
            yield from keys(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def comments(lines: list[str]) -> Iterator[str]:
    """What the comments of a YAML file say, line by line.

    Not those in its list of defaults, nor in Hydra's text of `--help`.
    """
    left_out = False
    for line in lines:
        if re.match(r"(  )?\w", line):
            left_out = line.startswith(("defaults:", "  help:"))
        found = re.search(r"(?:^|\s)#\s*(.*)", line)
        if found and not left_out and not line.startswith("# @package"):
            yield found[1].strip().removesuffix(".")


@pytest.mark.parametrize("path", YAMLS, ids=lambda path: path.relative_to(CONF).as_posix())
def test_every_key_and_comment_is_in_the_reference(path: Path, reference: str) -> None:
    text = path.read_text(encoding="utf-8")
    package = re.match(r"# @package (\S+)", text)
    prefix = "" if path.parent == CONF else f"{path.parent.name}."
    if package:
        prefix = "" if package[1] == "_global_" else f"{package[1]}."
    values = yaml.safe_load(text)
    values.pop("defaults", None)
    values.get("hydra", {}).pop("help", None)  # the text of `--help`
    terms = re.findall(r"^`([^`]+)`", reference, re.MULTILINE)
    for key in keys(values, prefix):
        option = key.endswith("name") and path.parent != CONF
        assert option or any(key == term or key.startswith(f"{term}.") for term in terms), key
    assert f"**`{path.stem}`**" in reference or path.parent == CONF
    for comment in comments(text.splitlines()):
        assert comment in reference


@pytest.mark.parametrize(
    "entry",
    [
        # The same for all options; one line for each value; a value and a meaning for each option.
        "`env.push.length` = `0.06`\n: m that the tool travels, counted from `length_from` (the "
        "authors' 0.06). *Must be above 0",
        "`viz.episodes`\n: `both`, `video`: `1`\n: `none`: `0`\n: `rerun`: `3`\n: number of "
        "episodes to record, starting",
        "`env.scenario.max_tries`\n: `circle`, `line`, `random`, `sort`, `swap`: `100`: placements "
        "tried per object (line: per row) before other objects are drawn. *Must lie between 1 and "
        "100000",
        # Inherited from the option that it extends, with a comment above it there.
        "`model.features`\n: `gt_pose_gcn`: `position`: node features: center",
        "- **`push_model`**: Beyond the paper: ",
        "Picks `train=push_model`, `budget=push_model`, `curriculum=many`, `her=off`.",
        "`robot@train.env.robot=...` picks another one for that key, by default `gripper`.",
    ],
)
def test_entries_of_the_reference(entry: str, reference: str) -> None:
    assert entry in reference


# ---------------------------------------------------------------------- commands


def commands() -> list[tuple[str, str]]:
    """Every command line in a page's blocks and in its text, by page."""
    found = []
    for path, text in TEXTS.items():
        blocks = re.findall(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        lines = [line for kind, block in blocks if kind == "sh" for line in block.splitlines()]
        prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
        lines += re.findall(r"`((?:python|sdfgcn) [^`]+)`", " ".join(prose.split()))
        lines = [part for line in lines for part in line.split(" && ")]
        found += [(name(path), line) for line in dict.fromkeys(lines)]
    return found


RUNS = [
    pytest.param(line, id=f"{page}: {line}")
    for line, page in {line: page for page, line in commands()}.items()
    if line.startswith(("python run.py", "sdfgcn ")) and "<name>" not in line
]


@pytest.mark.parametrize("line", RUNS)
def test_overrides_of_a_command_exist(line: str) -> None:
    words = shlex.split(line.removeprefix("python run.py").removeprefix("sdfgcn"), comments=True)
    choices = []
    for override in OverridesParser.create().parse_overrides([w for w in words if w[0] != "-"]):
        if override.is_sweep_override():
            key = override.get_key_element()
            values = [f"{key}={value}" for value in override.sweep_string_iterator()]
            choices.append(values if (CONF / key).is_dir() else values[:1])
        else:
            choices.append([override.input_line])
    for number in range(max(map(len, choices), default=1)):  # several values at once
        compose_config(*(values[number % len(values)] for values in choices))


def test_a_command_with_an_unknown_option_is_found() -> None:
    assert len(RUNS) > 30
    with pytest.raises(Exception, match="sdfgnc"):
        test_overrides_of_a_command_exist("python run.py -m model=sdf_cnn,sdfgnc seed=0")


def test_scripts_and_modules_exist() -> None:
    named = [re.match(r"python (-m )?(\S+)", line) for _, line in commands()]
    found = {(bool(each[1]), each[2]) for each in named if each}
    assert (False, "experiments/comparison.py") in found
    for is_module, target in found:
        assert find_spec(target) if is_module else (ROOT / target).is_file(), target


# ---------------------------------------------------------------------- links, files, figures


def anchors(path: Path) -> set[str]:
    heads = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_links_lead_somewhere(path: Path) -> None:
    generated = {"config_reference.md"}  # its headings are made when the manual is built
    for link in re.findall(r"\]\(([^)\s]+)\)", TEXTS[path]):
        target, _, anchor = link.partition("#")
        if target.startswith("http"):
            continue
        file = path.parent / target if target else path
        assert file.exists(), link
        assert not anchor or file.name in generated or anchor in anchors(file), link


@pytest.mark.parametrize("path", TEXTS, ids=name)
def test_result_files_exist(path: Path) -> None:
    for file in re.findall(r"`(experiments/results/[\w./*-]+)`", TEXTS[path]):
        assert list(ROOT.glob(file.rstrip("/"))), file


def test_the_readme_is_one_page() -> None:
    assert len(TEXTS[ROOT / "README.md"].splitlines()) < 200


def test_the_readme_shows_the_default_run() -> None:
    first, *others = json.loads((ROOT / "experiments/results/default.json").read_text())
    assert f"```text\n{report(first, others)}\n```" in TEXTS[ROOT / "README.md"]


def test_the_readme_names_every_option() -> None:
    """Of the groups in its table."""
    rows = re.findall(r"^\| `(\w+)` \| (.*) \|$", TEXTS[ROOT / "README.md"], re.MULTILINE)
    assert "model" in dict(rows)
    for group, cell in rows:
        options = {path.stem for path in (CONF / group).glob("*.yaml")}
        assert options <= set(re.findall(r"`(\w+)`", cell)), group
