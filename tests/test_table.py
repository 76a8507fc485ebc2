"""`experiments/table.py`: run folders to a table."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "experiments"))

import common  # noqa: E402
import table  # noqa: E402

from sdfgcn.errors import SdfgcnError  # noqa: E402

PAGE = "# Title\n<!-- results:mine -->\nold\n<!-- /results -->\nEnd\n"


def finished_run(folder: Path, **changes: object) -> Path:
    """A run folder as run.py leaves it; 3 of 4 episodes succeeded."""
    results = {
        "model": "rule_based",
        "objects": "scanned",
        "split": "test",
        "n_objects": 3,
        "robot": "gripper",
        "scenario": "random",
        "perception": "oracle",
        "seed": 7,
        "episodes": 4,
        "success_rate": 0.75,
        "success_rate_ci95": [0.301, 0.954],
        "pushes": 40.26,
        "pushes_ci95": [30.04, 50.47],
        "error_mm": 28.0,
        "error_mm_ci95": [20.0, 36.0],
        "out_of_range_rate": 0.25,
        "episode_seeds": [11, 12, 13, 14],
        "versions": {"mujoco": "3.17.0"},
        "git": {"commit": "0123456789abcdef", "dirty": False},
    }
    state = changes.pop("state", "done")
    folder.mkdir(parents=True)
    status = {"state": state, "overrides": ["seed=7"], "ended": "2026-01-31T12:00:00+00:00"}
    (folder / "status.json").write_text(json.dumps(status))
    if state == "done":
        (folder / "results.json").write_text(json.dumps(results | changes))
    return folder


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def body(text: str) -> list[list[str]]:
    """The table's rows below its head."""
    return [cells(line) for line in text.splitlines() if line.startswith("|")][2:]


def test_a_row_stands_beside_the_paper(tmp_path: Path) -> None:
    text = table.markdown(table.collect([finished_run(tmp_path / "run")]))
    title, _, head, *_ = text.splitlines()
    assert title == "Model rule_based, split test, scenario random, perception oracle."
    assert cells(head)[:5] == ["n objects", "objects", "robot", "seed", "episodes"]
    (row,) = body(text)
    assert row == [
        *("3", "scanned", "gripper", "7", "4", "75% [30, 95]", "69%", "40.3 [30.0, 50.5]", "59.1"),
        *("28.0 [20.0, 36.0]", "28.8", "25%"),
    ]
    assert "Paper: table II. Commit 0123456789; MuJoCo 3.17.0." in text


def test_rows_come_sorted_from_a_sweep_and_from_single_runs(tmp_path: Path) -> None:
    for job, n in enumerate((6, 2)):
        finished_run(tmp_path / "sweep" / str(job), n_objects=n)
    single = finished_run(tmp_path / "single", n_objects=4, robot="ur5e")
    rows = table.collect([tmp_path / "sweep", single, single])
    assert [(row["n_objects"], row["robot"]) for row in rows] == [
        *((2, "gripper"), (4, "ur5e"), (6, "gripper")),
    ]


def test_nothing_succeeded_and_nothing_in_the_paper(tmp_path: Path) -> None:
    none = {"pushes": None, "pushes_ci95": None, "error_mm": None, "error_mm_ci95": None}
    failed = {"success_rate": 0.0, "success_rate_ci95": [0.0, 0.49], "scenario": "swap", **none}
    text = table.markdown(table.collect([finished_run(tmp_path / "run", **failed, git=None)]))
    (row,) = body(text)
    assert row[5:] == ["0% [0, 49]", "-", "-", "-", "-", "-", "25%"]
    assert "Paper:" not in text
    assert "Commit unknown;" in text


def test_what_differs_becomes_a_column(tmp_path: Path) -> None:
    folders = [
        finished_run(tmp_path / split, split=split, git={"commit": "f" * 40, "dirty": True})
        for split in ("test", "train")
    ]
    text = table.markdown(table.collect(folders))
    assert text.startswith("Model rule_based, scenario random, perception oracle.\n")
    assert [(row[0], row[7]) for row in body(text)] == [("test", "69%"), ("train", "68%")]
    assert "Paper: table I and table II. Commit ffffffffff with uncommitted changes;" in text


def test_learned_models(tmp_path: Path) -> None:
    trained = {"model": "sdfgcn", "curriculum": "off", "trained_objects": 3, "loop_distance": None}
    trained["eval_seed"] = 5
    folders = [finished_run(tmp_path / "0", **trained, epsilon=0.1)]
    folders += [finished_run(tmp_path / "1", **{**trained, "epsilon": 0.0, "loop_distance": 0.01})]
    text = table.markdown(table.collect(folders))
    assert text.startswith(
        "Model sdfgcn, split test, scenario random, perception oracle, curriculum off, "
        "eval seed 5.\n"
    )
    assert [(row[:2], row[8], row[10]) for row in body(text)] == [
        (["0.0", "0.01"], "80%", "34.6"),
        (["0.1", "-"], "80%", "34.6"),
    ]
    assert "Paper: table II (SDFGCN-fixed)." in text
    several = [*folders, finished_run(tmp_path / "2")]  # beside the rule-based agent
    rows = body(table.markdown(table.collect(several)))
    assert [(row[:2], row[-6]) for row in rows] == [
        *((["rule_based", "-"], "69%"), (["sdfgcn", "off"], "80%"), (["sdfgcn", "off"], "80%")),
    ]


def test_what_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    finished_run(tmp_path / "sweep" / "0")
    broken = finished_run(tmp_path / "sweep" / "1", state="failed")
    out = tmp_path / "results"
    options = ["--page", str(page), "--results", str(out)]
    assert table.main(["mine", str(tmp_path / "sweep"), *options]) == 0
    printed = capsys.readouterr()
    assert printed.err == f"Left out: {broken} (failed).\nWrote {out}/mine.*, {page}.\n"
    (row,) = json.loads((out / "mine.json").read_text())
    assert row["episode_seeds"] == [11, 12, 13, 14]
    assert row["git"]["commit"] == "0123456789abcdef"
    assert (row["overrides"], row["paper"]["pushes"]) == (["seed=7"], 59.1)
    text = (out / "mine.md").read_text()
    assert printed.out == text
    once = f"# Title\n<!-- results:mine -->\n{text}<!-- /results -->\nEnd\n"
    assert page.read_text() == once
    assert table.main(["mine", str(tmp_path / "sweep"), *options]) == 0
    assert page.read_text() == once


@pytest.mark.parametrize("publish", [False, True])
def test_tracked_files_are_written_only_when_asked(
    publish: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a checkout of its own, with a page of the docs that has the table's place."""
    monkeypatch.setattr(table, "ROOT", tmp_path)
    monkeypatch.setattr(common, "RESULTS", tmp_path / "tracked")
    monkeypatch.setattr(common, "SCRATCH", tmp_path / "ignored")
    page = tmp_path / "docs" / "results.md"
    page.parent.mkdir()
    page.write_text(PAGE)
    (tmp_path / "README.md").write_text("no place\n")
    run = finished_run(tmp_path / "run")
    assert table.main(["mine", str(run), *(["--publish"] if publish else [])]) == 0
    written = [path for path in ("tracked", "ignored") if (tmp_path / path / "mine.md").exists()]
    assert written == ["tracked" if publish else "ignored"]
    assert ("rule_based" in page.read_text()) == publish
    assert (tmp_path / "README.md").read_text() == "no place\n"


@pytest.mark.parametrize("state", ["running", "failed", None])
def test_refuses_a_folder_without_a_finished_run(
    state: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = finished_run(tmp_path / "good")
    folder = tmp_path / "runs"
    if state is not None:
        finished_run(folder / "0", state=state)
    assert table.main(["mine", str(good), str(folder), "--results", str(tmp_path / "out")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{folder} holds no finished run; give run folders")
    assert not (tmp_path / "out").exists()


def test_writes_nothing_when_the_page_has_no_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    folder = finished_run(tmp_path / "run")
    options = ["--page", str(page), "--results", str(tmp_path / "out")]
    assert table.main(["another", str(folder), *options]) == 1
    assert "has no lines <!-- results:another --> and <!-- /results -->" in capsys.readouterr().err
    assert page.read_text() == PAGE
    assert not (tmp_path / "out").exists()


def test_a_marker_does_not_reach_into_the_next_table() -> None:
    text = "<!-- results:a -->\n<!-- results:b -->\n<!-- /results -->\n"
    with pytest.raises(SdfgcnError, match="results:a"):
        table.filled(text, "a", "new\n", Path("page.md"))


def test_a_damaged_run_is_named(tmp_path: Path) -> None:
    folder = finished_run(tmp_path / "run")
    (folder / "results.json").write_text('{"model": ')
    with pytest.raises(SdfgcnError, match=r"run/results\.json cannot be read"):
        table.collect([folder])


@pytest.mark.parametrize("name", ["calibration", "first", "table1", "table2", "beyond"])
def test_the_results_page_has_its_place(name: str) -> None:
    page = ROOT / "docs" / "results.md"
    assert "new\n" in table.filled(page.read_text(), name, "new\n", page)


@pytest.mark.parametrize("name", ["calibration", "first", "table1", "beyond"])
def test_the_results_page_says_what_the_results_say(name: str) -> None:
    """The published table is the one in `results/`."""
    text, page = (ROOT / "experiments/results" / f"{name}.md").read_text(), ROOT / "docs/results.md"
    assert table.filled(page.read_text(), name, text, page) == page.read_text()


def test_a_name_is_no_path(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as stopped:
        table.main(["../mine", str(tmp_path)])
    assert stopped.value.code == 2
