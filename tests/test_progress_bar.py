"""Progress: one line redrawn on a terminal, lines from time to time elsewhere."""

import io
import re
import sys
import time
from pathlib import Path

import pytest

from sdfgcn import progress_bar as module
from sdfgcn.progress_bar import progress_bar

ROOT = Path(__file__).parents[1]


class Terminal(io.StringIO):
    """A stderr that is a terminal."""

    def isatty(self) -> bool:
        return True


class Log:
    """What was written on stderr, which is no terminal in tests."""

    def __init__(self, captured: pytest.CaptureFixture[str]) -> None:
        self._captured = captured
        self._text = ""

    def getvalue(self) -> str:
        self._text += self._captured.readouterr().err
        return self._text


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Log:
    """Lines every 0.1 s instead of every ten."""
    monkeypatch.setattr(module, "SECONDS", 0.1)
    return Log(capsys)


def test_lines_with_the_time_left_where_there_is_no_terminal(log: Log) -> None:
    items = [time.sleep(0.05) for _ in progress_bar(range(10), unit="object", desc="Building")]
    assert len(items) == 10
    lines = log.getvalue().splitlines()
    assert 2 <= len(lines) <= 7  # 0.5 s of work, and the last line
    for line in lines:
        assert re.fullmatch(r"Building: .* \d+/10 \[.*<.*\]", line), line
    assert "10/10" in lines[-1] and "10/10" not in lines[0]


def test_a_line_also_while_one_item_takes_long(log: Log) -> None:
    with progress_bar(total=2, unit="object") as bar:
        bar.set_postfix_str("a mesh with many faces", refresh=False)
        time.sleep(0.35)
        assert "0/2" in log.getvalue() and "a mesh with many faces" in log.getvalue()


def test_what_takes_a_moment_writes_nothing(log: Log) -> None:
    assert list(progress_bar(range(3), unit="object")) == [0, 1, 2]
    assert log.getvalue() == ""


def test_nothing_is_written_once_it_is_closed(log: Log) -> None:
    bar = progress_bar(total=5, initial=2, unit="push")
    time.sleep(0.15)
    bar.update(3)
    bar.close()
    assert "5/5" in log.getvalue()
    written = log.getvalue()
    time.sleep(0.25)
    assert log.getvalue() == written


def test_an_abandoned_iteration_ends(log: Log) -> None:
    for item in progress_bar(range(10), unit="object"):
        time.sleep(0.15)
        if item == 1:
            break
    written = log.getvalue()
    assert "/10" in written
    time.sleep(0.25)
    assert log.getvalue() == written


def test_one_line_is_redrawn_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    assert list(progress_bar(range(3), unit="object")) == [0, 1, 2]
    assert "\r" in screen.getvalue() and "3/3" in screen.getvalue()


def test_every_bar_is_made_here() -> None:
    files = [path for path in (ROOT / "sdfgcn").rglob("*.py") if "tqdm" in path.read_text()]
    assert [path.name for path in files] == ["progress_bar.py"]
