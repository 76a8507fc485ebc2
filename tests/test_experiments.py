"""What `experiments/` works out besides running things: scenes, tables, figures, file names."""

import json
import runpy
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from configs import real_config

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "experiments"))

import benchmark  # noqa: E402
import common  # noqa: E402
import faults  # noqa: E402
import faults_table  # noqa: E402
import perception  # noqa: E402
import perception_matching as matching  # noqa: E402
import perception_page as page  # noqa: E402
import perception_segmentation as segmentation  # noqa: E402
import physics  # noqa: E402
import pictures  # noqa: E402
import summary  # noqa: E402

from sdfgcn.errors import SdfgcnError  # noqa: E402
from sdfgcn.segmentation.metrics import MaskScores, Score  # noqa: E402

SMALL = ("objects=household", "robot=gripper")


def masks(*areas: int) -> np.ndarray:
    """Masks of so many pixels, each in a line of its own."""
    result = np.zeros((len(areas), 12, 12), dtype=bool)
    for k, area in enumerate(areas):
        result[k, k, :area] = True
    return result


def seen(*areas: int) -> matching.View:
    return matching.View(np.zeros((12, 12, 3), dtype=np.uint8), masks(*areas))


def row(n: int, wrong: tuple[int, ...] = (), scenes: int = 10) -> dict:
    share = 1.0 - len(wrong) / scenes
    kind = {"scenes_right": share, "scenes_right_ci95": [0.5, 1.0], "objects_right": 0.975}
    kinds = dict.fromkeys(matching.KINDS, kind)
    return {"n_objects": n, "scenes": scenes, "wrong_scenes": list(wrong), **kinds}


# ---------------------------------------------------------------------- common


def test_a_result_is_named_after_what_is_unusual() -> None:
    usual = {"oracle", "scanned"}
    assert common.file_name("benchmark", ("oracle", "scanned"), usual) == "benchmark"
    name = common.file_name("benchmark", ("vision", "household"), usual)
    assert name == "benchmark_vision_household"


def test_the_command_line_of_an_experiment(capsys: pytest.CaptureFixture[str]) -> None:
    own = {"pushes": 400, "repeats": 3}
    given = common.parse(["pushes=7", "robot=gripper", "--publish"], own, "About.")
    assert given == ({"pushes": 7, "repeats": 3}, ["robot=gripper"], common.RESULTS)
    assert common.parse([], own, "About.").folder == ROOT / "outputs" / "experiments"
    with pytest.raises(SystemExit) as ended:
        common.parse(["--help"], own, "About.")
    assert ended.value.code == 0
    assert capsys.readouterr().out.startswith("About.\n\n  pushes=400 repeats=3\n  --publish")


@pytest.mark.parametrize(
    ("argument", "told"),
    [
        ("pushes=many", "pushes is 'many', but must be a whole number from 0 on."),
        ("--publsh", "There is no option --publsh; there are --help and --publish."),
        ("n_objects=99", "n_objects is 99, but must lie between 1 and env.max_objects (8)."),
        (
            "objects=rocks",
            "There is no objects=rocks: objects can be household, scanned, shapenet.",
        ),
    ],
)
def test_a_mistake_is_one_sentence(
    argument: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        common.run(lambda: common.load(common.parse([argument], {"pushes": 1}, "").overrides)) == 1
    )
    assert capsys.readouterr().err == told + "\n"


COMMANDS = sorted(
    path for path in (ROOT / "experiments").glob("*.py") if "__main__" in path.read_text()
)


@pytest.mark.parametrize("path", COMMANDS, ids=lambda path: path.stem)
def test_every_command_has_help(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also what it says of `--publish`, if it writes results."""
    sys_argv, sys.argv = sys.argv, [str(path), "--help"]
    try:
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(path), run_name="__main__")
    finally:
        sys.argv = sys_argv
    assert not ended.value.code
    assert "--publish" in capsys.readouterr().out


# ---------------------------------------------------------------------- faults


def struck(fault: str, *wrong: str, case: str = "evaluation") -> faults_table.Strike:
    return faults_table.Strike(case, fault, 1.0, list(wrong))


def test_faults_are_counted_by_command_and_kind() -> None:
    trials = [
        faults_table.Trial("evaluation", [struck("SIGKILL"), struck("SIGTERM", "hung")], []),
        faults_table.Trial("evaluation", [struck("SIGKILL")], ["other rows"]),
        faults_table.Trial("evaluation", [], []),  # ended before it was struck
    ]
    own = {"minutes": 2, "seed": 7}
    exact = {"training": False, "evaluation": True}
    others = [struck("disk full", case="training")]
    result = faults_table.outcome(trials, others, exact, own)
    assert (result["strikes"], result["resumed"], len(result["wrong"])) == (4, 2, 2)
    rows = [(row["what"], row["fault"], row["n"], row["wrong"]) for row in result["rows"]]
    assert rows == [
        ("training", "disk full", 1, []),
        ("evaluation", "SIGKILL", 2, []),
        ("evaluation", "SIGTERM", 1, [["hung"]]),
        ("evaluation", "then resumed: same as undisturbed", 2, [["other rows"]]),
    ]
    twice = faults_table.united([result, {**result, "seeds": [8]}])
    assert (twice["strikes"], twice["minutes"], twice["seeds"]) == (8, 4, [7, 8])
    assert [row["n"] for row in twice["rows"]] == [2, 4, 2, 4]
    assert "| evaluation | SIGTERM | 2 | 0 | hung (2) |" in faults_table.markdown(twice)
    with pytest.raises(SystemExit, match="different commits"):
        faults_table.united([result, {**result, "git": None}])


def test_what_is_wrong_with_an_end() -> None:
    def told(fault: str, code: int | None, *states: str, orphans: int = 0, log: str = "") -> list:
        return faults.complaints(fault, faults.Ended(code, True, orphans, 1.0, log), states)

    assert told("SIGTERM", 143, "stopped") == []
    assert told("SIGTERM", -15) == []  # before the run had begun
    assert told("SIGKILL", -9, "running") == []
    assert told("SIGTERM", -15, "running") == [
        "status.json says running",
        "exit code -15, not 143",
    ]
    assert told("SIGINT to all", None, orphans=2) == ["hung", "2 processes left"]
    assert told("disk full", 1, "failed", log="Traceback\nKeyError: 'a'") == [
        "traceback: KeyError: 'a'"
    ]


def test_what_a_run_left_does_not_depend_on_time(tmp_path: Path) -> None:
    for folder, seconds in (("a", "1"), ("b", "2")):
        (tmp_path / folder / "0").mkdir(parents=True)
        table = f"episode,wall_s\n0,{seconds}\n"
        (tmp_path / folder / "0" / "episodes.csv").write_text(table)
    assert faults.left_in(tmp_path / "a") == faults.left_in(tmp_path / "b")
    assert faults.left_in(tmp_path / "a") == {"0/episodes.csv": [{"episode": "0"}]}
    case = faults.Case("a", ())
    assert faults.differences(case, tmp_path / "a", faults.left_in(tmp_path / "b")) == []
    (tmp_path / "a" / "0" / "weights.safetensors").write_bytes(b"other")
    told = faults.differences(case, tmp_path / "a", faults.left_in(tmp_path / "b"))
    assert told == ["other 0/weights.safetensors"]


# ---------------------------------------------------------------------- physics


def test_only_what_comes_to_lie_on_another_side_has_turned() -> None:
    half = np.sqrt(0.5)
    upright = [0.0, 0.0, 0.1, 1.0, 0.0, 0.0, 0.0]
    # A quarter turn about z, one about x, and 60 degrees about y.
    quats = ([half, 0, 0, half], [half, half, 0, 0], [np.sqrt(0.75), 0, 0.5, 0])
    after = np.array([[0.1, 0.2, 0.1, *quat] for quat in quats])
    np.testing.assert_allclose(physics.turn(np.array([upright] * 3), after), [0, 90, 60], atol=1e-6)


def test_summary_of_pushes_by_hand() -> None:
    effects = [
        physics.Effect("done", 0.04, 0.05, (("mug", False), ("can", True)), "mug", 0),
        physics.Effect("done", 0.06, 0.11, (), "can", 1),
        physics.Effect("blocked", 0.0, 0.0, (), "mug", 0),
        physics.Effect("done", 0.02, 0.02, (("mug", False),), "mug", 0),
    ]
    found = physics.summary(effects, length=0.06)
    assert found["status"] == {"done": 3, "blocked": 1}
    assert found["pushed_object_mm"]["median"] == pytest.approx(40.0)  # of the three done
    assert found["furthest_object_mm"]["max"] == pytest.approx(110.0)
    assert (found["moved_over_length_plus_40_mm"], found["below_table"]) == (1, 1)
    assert (found["share_tipped"], found["share_rolled_over"]) == (0.5, 0.25)
    assert found["tipped"] == {"mug": 2}
    compared = physics.against(effects, [*effects[:3], effects[1]])
    assert compared["difference_mm"]["max"] == pytest.approx(40.0)
    assert (compared["same_status"], compared["same_turned"]) == (1.0, 0.75)


# ---------------------------------------------------------------------- matching


def test_what_is_not_detected_is_no_part_of_a_scene() -> None:
    """Slots 0 to 3: 1 is too small at the start, 2 in the goal; the goal's order is 3 2 1 0."""
    config = real_config(*SMALL).env
    assert config.perception.min_pixels == 10
    scene = matching.shuffled(
        seen(10, 9, 11, 12), seen(12, 11, 9, 10), np.array([3, 2, 1, 0]), config
    )
    assert scene.current.masks.sum(axis=(1, 2)).tolist() == [10, 11, 12]  # slots 0, 2, 3
    assert scene.goal.masks.sum(axis=(1, 2)).tolist() == [10, 11, 12]  # slots 3, 1, 0
    assert scene.expected.tolist() == [2, -1, 0]


def test_an_object_that_the_goal_does_not_show_cannot_be_wrong() -> None:
    verdict = matching.right(np.array([2, 1, 1, -1]), np.array([2, -1, 0, 0]))
    assert verdict.tolist() == [True, True, False, False]


def test_a_scene_does_not_depend_on_those_before_it() -> None:
    config = real_config(*SMALL).env
    with closing(matching.Scenes(config, seed=0)) as scenes:
        later = scenes.draw(4, 1)
        for n in (2, 4):
            scenes.draw(n, 0)
        again = scenes.draw(4, 1)
    np.testing.assert_array_equal(again.current.pixels, later.current.pixels)
    np.testing.assert_array_equal(again.goal.masks, later.goal.masks)
    assert sorted(again.expected) == [0, 1, 2, 3]
    assert (matching.size(again.current) ** 2).ravel() == pytest.approx(
        again.current.masks.sum(axis=(1, 2))
    )
    color = again.goal.pixels[again.goal.masks[0]].mean(axis=0) / 255.0
    assert matching.mean_color(again.goal)[0] == pytest.approx(color)


def test_goes_on_only_with_its_own_rows(tmp_path: Path) -> None:
    head = {"seed": 0, "scenes": 10, "git": {"commit": "a", "dirty": False}}
    assert matching.finished(tmp_path, "mine", head) == []
    written = {**head, "git": {"commit": "a", "dirty": True}, "rows": [row(2), row(3)]}
    (tmp_path / "mine.json").write_text(json.dumps(written))
    assert matching.finished(tmp_path, "mine", head) == written["rows"]
    assert matching.finished(tmp_path, "mine", {**head, "seed": 1}) == []
    assert (
        matching.finished(tmp_path, "mine", {**head, "git": {"commit": "b", "dirty": False}}) == []
    )


def test_the_figure_shows_the_hardest_scenes_and_all_failures() -> None:
    rows = [row(5, (7,), 500), row(6, (0, 3), 500)]
    rights = [(6, k) for k in (1, 2, 4, 5, 6, 7, 8, 9)]
    assert matching.examples(rows) == [*rights, (6, 0), (6, 3), (5, 7)]


def test_matching_table() -> None:
    head, _, line = matching.markdown([row(3, (1,))]).splitlines()
    assert head.startswith("| n objects | scenes | wholly right |")
    share = "90.0% [50.0, 100.0]"
    assert line == f"| 3 | 10 | {share} | {share} | {share} | {share} | 97.5% |"
    assert len({text.count("|") for text in matching.markdown([row(3)]).splitlines()}) == 1


def test_both_ends_of_a_match_are_outlined_alike_and_mistakes_framed() -> None:
    """Object 0 goes right; 1 goes to 2 though it is 1; 2 goes nowhere."""
    blocks = np.zeros((3, 24, 24), dtype=bool)
    for k in range(3):
        blocks[k, 8 * k + 3 : 8 * k + 5, 8:12] = True
    view = matching.View(np.zeros((24, 24, 3), dtype=np.uint8), blocks)
    each = matching.Scene(view, view, expected=np.array([0, 1, 2]))
    found = np.array([0, 2, -1])
    picture = matching.pair(each, found, matching.right(found, each.expected), scale=3)
    start, goal = picture[:, :72], picture[:, 72:]

    def colours(part: np.ndarray, k: int) -> set[tuple[int, ...]]:
        block = part[24 * k : 24 * (k + 1)].reshape(-1, 3)
        return {tuple(map(int, colour)) for colour in block if colour.any()}

    (right,) = colours(start, 0)
    assert colours(goal, 0) == {right} and right != pictures.RED
    (mistaken,) = colours(start, 1) - {pictures.RED}
    assert mistaken != right and pictures.RED in colours(start, 1)
    assert colours(goal, 2) == {mistaken, pictures.RED}
    assert colours(start, 2) == {pictures.RED}  # without a match there is no outline
    assert colours(goal, 1) == set()


# ---------------------------------------------------------------------- segmentation


def test_segmentation_table_and_its_interval() -> None:
    def scored(found: int) -> MaskScores:
        return MaskScores(Score(1.0, 1.0), Score(1.0, 1.0), found=found, true=3)

    low, high = segmentation.counted([scored(3)] * 9 + [scored(2)])
    assert (low, high) == pytest.approx((0.5958, 0.9821), abs=1e-4)  # Wilson, 9 of 10
    line = segmentation.markdown(
        [
            {"objects": "scanned", "look": "own", "n_objects": 3, "scenes": 10, "overlap_f": 0.97,
             "boundary_f": 0.98, "count_right": 0.9, "count_right_ci95": [low, high]}
        ]
    ).splitlines()[2]  # fmt: skip
    assert line == "| scanned | own | 3 | 10 | 0.970 | 0.980 | 90% [60, 98] |"


def test_a_sheet_is_filled_line_by_line() -> None:
    tiles = [np.full((2, 3, 3), k, dtype=np.uint8) for k in range(3)]
    paper = pictures.sheet(tiles, columns=2, gap=1)
    assert paper.shape == (6, 8, 3)
    assert [int(paper[y, x, 0]) for y, x in ((0, 0), (0, 4), (3, 0), (3, 4), (0, 3))] == [
        *(0, 1, 2, 255, 255)
    ]


# ---------------------------------------------------------------------- pages


def test_main_rows() -> None:
    looks = ("own", "shifted")
    rows = [
        {"objects": "scanned", "look": look, "n_objects": n, "overlap_f": 0.9, "boundary_f": 0.8,
         "count_right": share, "count_right_ci95": [0.5, 1.0]}
        for look in looks
        for n, share in ((2, 0.1), (3, 0.3), (6, 0.6), ("2 to 6", 0.7))
    ]  # fmt: skip
    lines = page.segmentation(rows).splitlines()[2:]
    counts = "30% [50, 100] | 60% [50, 100] | 70% [50, 100]"
    assert lines == [
        f"| scanned | {look} | 0.900 | 0.800 | {counts} |" for look in ("own", "shifted")
    ]
    assert page.matching([row(4)]).splitlines()[2] == (
        "| 4 | 10 | 100.0% [50.0, 100.0] | 100.0% [50.0, 100.0] |"
    )


@pytest.mark.parametrize(
    ("publish", "name"), [(page.run, "docs/perception.md"), (summary.publish, "README.md")]
)
def test_a_page_says_what_the_results_say(
    publish: Callable[[Path], None], name: str, tmp_path: Path
) -> None:
    copy = tmp_path / "page.md"
    copy.write_text((ROOT / name).read_text())
    publish(copy)
    assert copy.read_text() == (ROOT / name).read_text()


def test_a_section_that_was_not_run_is_named(tmp_path: Path) -> None:
    copy = tmp_path / "page.md"
    copy.write_text((ROOT / "docs" / "perception.md").read_text())
    with pytest.raises(SdfgcnError, match=r"run `python experiments/perception.py segmentation`"):
        page.run(copy, results=tmp_path)


def test_the_readme_has_the_main_rows() -> None:
    """Of two experiments' files: held-out objects, the headline's conditions, the paper's world."""
    common = {"split": "test", "env": "paper", "success_threshold": 0.05, "n_objects": 3}
    headline = {**common, "eval": "default", "perception": "vision", "method": "sdfgcn"}
    others = [{"split": "train"}, {"n_objects": 4}, {"perception": "oracle"}, {"eval": "greedy"}]
    rows = [{**headline, **change} for change in ({}, *others)]
    assert summary.main_rows("table1", rows, (3,)) == [headline]
    assert summary.main_rows("table1", rows, (3, 4)) == [headline, rows[2]]


def test_an_unknown_section_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert perception.main(["matchin", "scenes=2"]) == 1
    assert capsys.readouterr().err == (
        "There is no section 'matchin'; there are segmentation, matching, page.\n"
    )


# ---------------------------------------------------------------------- benchmark


@pytest.fixture
def stopwatch(monkeypatch: pytest.MonkeyPatch) -> benchmark.Stopwatch:
    for functions in benchmark.PARTS.values():  # put back afterwards
        for owner, attribute in functions:
            monkeypatch.setattr(owner, attribute, getattr(owner, attribute))
    return benchmark.Stopwatch()


def test_no_time_counts_twice(stopwatch: benchmark.Stopwatch) -> None:
    inner = stopwatch._timed("inner", lambda: None)
    outer = stopwatch._timed("outer", inner)
    outer()
    assert dict(stopwatch.calls) == {"outer": 1}
    inner()
    assert dict(stopwatch.calls) == {"outer": 1, "inner": 1}


@pytest.mark.parametrize("name", ["oracle", "vision"])
def test_parts_of_the_benchmark(name: str, stopwatch: benchmark.Stopwatch) -> None:
    overrides = [*SMALL, f"perception={name}", "n_objects=2"]
    result = benchmark.measure(overrides, pushes=1, episode=1, stopwatch=stopwatch)
    looks = 3 if name == "vision" else 0  # goal, start, after the push
    assert stopwatch.calls["segmentation"] == looks
    assert stopwatch.calls["matching"] == looks + max(0, looks - 1)  # features; no match in a goal
    assert (result["ms_per_push"]["segmentation"] > 0) == (name == "vision")
    assert result["ms_per_push"]["python"] > 0
    config = real_config(*overrides)
    assert benchmark.result_name(config) == (
        "benchmark_vision_household" if name == "vision" else "benchmark_household"
    )
