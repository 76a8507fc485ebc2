"""`sdfgcn --help`: every option with its comment, on two screens."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from configs import CONF, compose_config
from omegaconf import OmegaConf

from sdfgcn.help import MAIN_KEYS, all_keys, help_text, summary

ROOT = Path(__file__).parents[1]
OPTIONS = sorted(CONF.glob("*/*.yaml"))
LINES = help_text().splitlines()


def test_two_screens() -> None:
    assert len(LINES) <= 100
    assert max(map(len, LINES)) <= 100


@pytest.mark.parametrize("file", OPTIONS, ids=lambda file: f"{file.parent.name}/{file.stem}")
def test_every_option_has_its_own_line(file: Path) -> None:
    shown: dict[tuple[str, str], str] = {}
    group = ""
    for line in LINES:
        group = line[2:14].strip() or group
        option, _, comment = line[15:].partition(" ")
        shown.setdefault((group, option.rstrip("*")), comment.strip())
    comment = shown[file.parent.name, file.stem]
    assert comment and comment == summary(file)  # short enough to stand there whole


def test_the_first_sentence_of_a_comment(tmp_path: Path) -> None:
    file = tmp_path / "toy.yaml"
    file.write_text(
        "# @package env.toy\n# As in Fig. 5 of Lee et al. 2020,\n# twice. Slow.\nname: toy\n"
    )
    assert summary(file) == "As in Fig. 5 of Lee et al. 2020, twice"
    file.write_text("name: toy # a toy\n")
    assert summary(file) == ""


@pytest.mark.parametrize("key", MAIN_KEYS)
def test_main_keys_have_the_value_of_a_run(key: str) -> None:
    (line,) = (line for line in LINES if line.startswith(f"  {key}="))
    shown, comment = line.split(maxsplit=1)
    value = OmegaConf.select(compose_config("model=rule_based", "train=default"), key)
    assert shown == f"{key}={'null' if value is None else value}"
    assert comment
    assert key in all_keys()


def test_the_command_prints_it_without_torch() -> None:
    code = "import sys; sys.argv = ['sdfgcn', '--help']; from sdfgcn.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}; assert not {{'torch', 'mujoco'}} & set(sys.modules)"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == help_text() + "\n"
