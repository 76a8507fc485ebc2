"""`experiments/learning_curve.py`: which rows it shows, what it writes and what it refuses."""

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "experiments"))

import learning_curve  # noqa: E402

from sdfgcn.files import CsvTable  # noqa: E402


def row(minute: float, **news: float) -> dict[str, float]:
    figures = {"pushes": 100 * minute, "updates": 12 * minute, "seconds": 60.0 * minute}
    return {
        **{"episodes": 4, "pushes_per_s": 2.0, "updates_per_s": 0.2, "success_rate": 0.25},
        **{"out_of_range_rate": 0.5, "episode_pushes": 25.2, "return": 1.0, "loss": 0.756},
        **{"epsilon": 0.8, "n_objects": 3, **figures, **news},
    }


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A training's folder with a row a minute."""
    folder = tmp_path / "run"
    folder.mkdir()
    rows = [row(minute, success_rate=minute / 20) for minute in range(1, 21)]
    CsvTable(folder / "train.csv", list(rows[0])).write(rows)
    return folder


def test_rows_are_spaced_in_time() -> None:
    rows = [row(minute) for minute in (1, 2, 3, 4, 5, 6, 7, 8, 20)]
    minutes = [each["seconds"] / 60 for each in learning_curve.spaced(rows, 4)]
    assert minutes == [5, 8, 20]  # the nearest to 5, 10, 15 (8 again) and 20


def test_what_is_written(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- results:mine_curve -->\nold\n<!-- /results -->\nrest\n")
    results = tmp_path / "results"
    options = ["--rows", "2", "--page", str(page), "--results", str(results)]
    assert learning_curve.main(["mine", str(folder), *options]) == 0
    table = (results / "mine_curve.md").read_text()
    assert table.splitlines()[2:4] == [
        "| 10 | 1000 | 120 | 0.80 | 50% | 50% | 25 | 0.76 |",
        "| 20 | 2000 | 240 | 0.80 | 100% | 50% | 25 | 0.76 |",
    ]
    assert (results / "mine_curve.csv").read_bytes() == (folder / "train.csv").read_bytes()
    assert (results / "mine_curve.png").read_bytes().startswith(b"\x89PNG")
    assert page.read_text().startswith(f"<!-- results:mine_curve -->\n{table}<!-- /results -->")
    assert capsys.readouterr().out == table


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (None, r"train\.csv cannot be read .*; give a training's folder"),
        ("pushes,seconds\nmany,1\n", "cannot be read"),
        ("pushes,seconds\n1\n", "cannot be read"),
        ("pushes,seconds\n", "has no rows yet"),
    ],
)
def test_what_is_no_curve(
    content: str | None, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "train.csv").write_text(content)
    out = tmp_path / "out"
    assert learning_curve.main(["mine", str(tmp_path), "--results", str(out)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(sentence, line)
    assert not out.exists()
