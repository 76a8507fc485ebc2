"""Recordings, read back: what stands in the file is what the episode did."""

import io
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from moments import ENV, SIZE, START, cube, episode_start, episode_steps, moment, record
from PIL import Image
from recordings import Recording

from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import RECORDERS
from sdfgcn.viz.words import q_table


@pytest.fixture(scope="module")
def recording_path(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "new folder" / "episode_000.rrd"
    record(path)
    return path


@pytest.fixture(scope="module")
def recording(recording_path):
    return Recording(recording_path)


@pytest.mark.parametrize("name", RECORDERS)
def test_every_recorder_takes_an_episode(name, tmp_path):
    path = tmp_path / "episode.rrd"
    record(path, name=name)
    made = list(tmp_path.iterdir())
    assert bool(made) == (name != "none")
    assert all(entry.stem == "episode" and entry.stat().st_size for entry in made)


def test_rerun_verifies_the_file(recording_path):
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(recording_path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr
    assert "1 file verified without error" in result.stdout + result.stderr


def test_entities_and_timeline(recording):
    per_slot = {
        f"/{folder}/{slot}"
        for folder in ("world/objects", "world/goal", "sdf/scene", "sdf/goal", "distance")
        for slot in range(3)
    }
    contours = {f"/sdf/{which}/{slot}/contour" for which in ("scene", "goal") for slot in range(3)}
    rest = {
        "/world/push",
        "/world/table",
        "/world/bounds/spawn",
        "/world/bounds/range",
        "/world/camera",
        "/world/camera/picture",
        "/world/camera/masks",
        "/world/camera/push",
        "/world/camera/graph",
        "/world/camera/goal",
        "/goal/picture",
        "/goal/masks",
        "/distance/threshold",
        "/reward/total",
        "/reward/terms/progress",
        "/reward/terms/step",
        "/outcome/return",
        "/outcome/success",
        "/outcome/out_of_range",
        "/q_values",
        "/q_values/table",
        "/log",
        "/summary",
    }
    assert per_slot | contours | rest <= recording.entities()
    assert recording.timelines == {"push"}
    assert recording.pushes("/world/camera/picture") == [0, 1, 2]
    assert recording.pushes("/world/push") == [1, 2]


def test_edges_of_the_graph(recording):
    strips = np.array(recording["/world/camera/graph", "LineStrips2D:strips"][1])
    # Among objects, from the lower row to the higher one, then to goals, by row. Slot 0 (row 1)
    # reached its goal at push 1.
    slots = np.array([[36, 48], [48, 24], [72, 72]])  # projected centres of the slots
    goals = np.array([[36, 48], [48, 36], [72, 24]])
    expected = [
        *([slots[2], slots[0]], [slots[2], slots[1]], [slots[0], slots[1]]),
        *([slots[2], goals[2]], [slots[0], goals[0]], [slots[1], goals[1]]),
    ]
    np.testing.assert_allclose(strips, expected)
    colors = recording["/world/camera/graph", "LineStrips2D:colors"][1]
    white, grey = 0xFFFFFFFF, 0xA0A0A0FF
    assert colors == [grey, grey, grey, white, white, white]


def test_arrow_is_the_projected_push(recording):
    # 48 pixels to the metre from the middle (48, 48); v grows downwards.
    origins = recording["/world/camera/push", "Arrows2D:origins"]
    vectors = recording["/world/camera/push", "Arrows2D:vectors"]
    np.testing.assert_allclose(origins[1], [[24, 48]], atol=1e-5)
    np.testing.assert_allclose(vectors[1], [[36, -12]], atol=1e-5)
    np.testing.assert_allclose(origins[2], [[72, 12]], atol=1e-5)
    np.testing.assert_allclose(vectors[2], [[0, 24]], atol=1e-5)
    np.testing.assert_allclose(recording["/world/push", "Arrows3D:vectors"][1], [[0.75, 0.25, 0]])
    assert recording["/world/camera/push", "Arrows2D:labels"][2] == ["blocked"]


def test_pictures_and_masks(recording):
    for entity, push, value in [
        ("/world/camera/picture", 0, 100),
        ("/world/camera/picture", 2, 101),
        ("/goal/picture", None, 50),
    ]:
        blob = recording[entity, "EncodedImage:blob"][push][0]
        picture = np.asarray(Image.open(io.BytesIO(bytes(blob))))
        assert picture.shape == (SIZE, SIZE, 3)
        assert (picture == value).all()
    # Classes go by slot (from 1), whatever the order of the rows.
    labels = recording["/world/camera/masks", "SegmentationImage:buffer"][0][0]
    labels = np.array(labels, dtype=np.uint8).reshape(SIZE, SIZE)
    assert [labels[48, 24], labels[24, 48], labels[72, 72], labels[0, 0]] == [1, 2, 3, 0]
    classes = recording["/", "AnnotationContext:context"][None][0]
    names = {entry["class_description"]["info"]["label"] for entry in classes}
    assert {"#0 red", "#1 green", "#2 blue"} <= names


def test_sdfs_are_drawn_when_they_change(recording):
    assert [recording.pushes(f"/sdf/scene/{slot}") for slot in range(3)] == [[0, 1], [0], [0]]
    buffer = recording["/sdf/scene/0", "DepthImage:buffer"][1][0]
    drawn = np.array(buffer, dtype=np.uint8).view(np.float16).reshape(SIZE, SIZE)
    np.testing.assert_allclose(drawn, episode_steps()[0].after.scene.sdf[1], atol=0.04)
    # Slot 0 lies at (36, 48) now; its mask is 10 pixels wide. Corners are cut between pixels.
    contour = np.concatenate(recording["/sdf/scene/0/contour", "LineStrips2D:strips"][1])
    np.testing.assert_allclose(contour.min(axis=0), [31, 43], atol=0.05)
    np.testing.assert_allclose(contour.max(axis=0), [41, 53], atol=0.05)


def test_poses_and_meshes(recording):
    moves = recording["/world/objects/0", "Transform3D:translation"]
    np.testing.assert_allclose(moves[0], [[-0.5, 0, 0]])
    np.testing.assert_allclose(moves[1], [[-0.25, 0, 0]])
    quaternion = recording["/world/objects/0", "Transform3D:quaternion"][0]  # w comes last
    np.testing.assert_allclose(quaternion, [[0, 0, np.sqrt(0.5), np.sqrt(0.5)]], rtol=1e-6)
    goals = recording["/world/goal/2", "Transform3D:translation"]
    np.testing.assert_allclose(goals[None], [[0.5, 0.5, 0]])
    vertices = recording["/world/objects/0", "Mesh3D:vertex_positions"][None]
    np.testing.assert_allclose(vertices, cube("red").vertices)
    assert recording["/world/objects/0", "Mesh3D:albedo_factor"][None] == [0xFF0000FF]
    assert ("/world/objects/1", "Mesh3D:albedo_texture_buffer") in recording.values
    alpha = recording["/world/goal/1", "Mesh3D:albedo_factor"][None][0] & 0xFF
    assert 0 < alpha < 255


def test_figures(recording):
    def series(entity):
        return {push: cell[0] for push, cell in recording[entity, "Scalars:scalars"].items()}

    assert series("/distance/2") == {1: 1.0, 2: 1.0}
    assert series("/distance/threshold") == {1: 0.05, 2: 0.05}
    assert series("/reward/total") == {1: 7.48, 2: -0.02}
    assert series("/reward/terms/progress") == {1: 7.5, 2: 0.0}
    assert series("/outcome/return") == pytest.approx({1: 7.48, 2: 7.46})
    assert series("/outcome/success") == {1: 0.0, 2: 0.0}
    q_values = recording["/q_values", "Tensor:data"][1][0]
    assert q_values["shape"] == [3, 8]  # three rows; padding is left out


def test_q_values_in_words(recording):
    texts = recording["/q_values/table", "TextDocument:text"]
    title, _, head, _, *rows, _, note = texts[1][0].splitlines()
    # Row 1 shows slot 0. Values count up to 23 from row to row; direction 2 is not legal.
    assert title == "#0 red towards 45 degrees: number 13 by Q-value of 21 legal pushes."
    assert head.startswith("| object | → 0° | ↗ 45° | ↑ 90° |")
    assert [row.split(" | ")[:4] for row in rows] == [
        ["| #2 blue", "0.00", "1.00", "(2.00)"],
        ["| #0 red", "8.00", "**9.00**", "(10.00)"],
        ["| #1 green", "16.00", "17.00", "(18.00)"],
    ]
    assert note == "Bold: the push. In brackets: not legal."
    assert texts[2][0].splitlines()[0].startswith("#2 blue towards 270 degrees: number 16 by")


def test_the_highest_q_value():
    first, _ = episode_steps()
    best = replace(first, q_values=-np.abs(np.arange(32.0).reshape(4, 8) - 9))
    told = q_table(["a", "b", "c"], best)
    assert told.startswith("b towards 45 degrees: the highest Q-value of 21 legal pushes.")


def test_words(recording):
    log = {push: cell[0] for push, cell in recording["/log", "TextLog:text"].items()}
    assert log[1].startswith("#0 red towards 45 degrees: done")  # row 1 shows slot 0
    summary = recording["/summary", "TextDocument:text"][None][0]
    assert "Seed 7: step limit" in summary
    assert "| #2 blue | block | 1000 |" in summary


def test_layout_comes_with_the_file(recording):
    assert recording.blueprints == recording.applications == {"sdfgcn 3 objects"}


def test_objects_that_vanish_and_false_detections(tmp_path):
    first, second = episode_steps()
    vanished = moment(START, order=[2, None, 1])
    ghost = moment([(-0.9, -0.9), *START[1:]], order=[0])
    ghost = replace(ghost, poses=vanished.poses)  # a mask where no object lies
    steps = [replace(first, after=vanished), replace(second, after=ghost, q_values=None)]
    record(tmp_path / "a.rrd", steps=steps)
    recording = Recording(tmp_path / "a.rrd")
    assert recording["/sdf/scene/0", "Clear:is_recursive"] == {1: [True]}
    assert recording["/sdf/scene/1", "Clear:is_recursive"] == {2: [True]}
    labels = recording["/world/camera/masks", "SegmentationImage:buffer"][2][0]
    assert set(labels) == {0, 4}  # 4: "unmatched"


def test_a_row_between_others_that_was_empty_before_the_push(tmp_path):
    """The agent values every row; names and values stay in step where one is empty."""
    first, second = episode_steps()
    record(tmp_path / "a.rrd", steps=[replace(first, after=moment(START, [2, None, 1])), second])
    text = Recording(tmp_path / "a.rrd")["/q_values/table", "TextDocument:text"][2][0]
    assert [row.split(" | ")[:2] for row in text.splitlines()[4:7]] == [
        ["| #2 blue", "0.00"],
        ["| row 1", "8.00"],
        ["| #1 green", "16.00"],
    ]


# ------------------------------------------------------------------ files


def test_an_episode_without_a_push(tmp_path):
    record(tmp_path / "a.rrd", steps=[])
    recording = Recording(tmp_path / "a.rrd")
    assert recording.blueprints
    assert "no push" in recording["/summary", "TextDocument:text"][None][0]


def test_an_interrupted_episode_leaves_no_finished_file(tmp_path):
    path = tmp_path / "a.rrd"
    with pytest.raises(KeyboardInterrupt), RECORDERS["rerun"](path, ENV) as recorder:
        recorder.start(episode_start())
        raise KeyboardInterrupt
    assert not path.exists()
    record(path)  # the next try writes over what was left
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.rrd"]
    assert Recording(path).pushes("/world/push") == [1, 2]


def test_recorders_do_not_mix(tmp_path):
    import rerun

    with RECORDERS["rerun"](tmp_path / "a.rrd", ENV) as a:
        a.start(episode_start(seed=1))
        with RECORDERS["rerun"](tmp_path / "b.rrd", ENV) as b:
            b.start(episode_start(seed=2))
            a.step(episode_steps()[0])
    assert rerun.get_global_data_recording() is None
    assert Recording(tmp_path / "a.rrd").pushes("/world/push") == [1]
    assert "/world/push" not in Recording(tmp_path / "b.rrd").entities()


def test_unwritable_place(tmp_path):
    (tmp_path / "file").touch()
    recorder = RECORDERS["rerun"](tmp_path / "file" / "a.rrd", ENV)
    with pytest.raises(SdfgcnError, match="Cannot write the recording"):
        recorder.start(episode_start())


def test_missing_pictures(tmp_path):
    episode = episode_start()
    episode = replace(episode, start=replace(episode.start, pixels=None))
    with pytest.raises(SdfgcnError, match=r"env\.record"):
        RECORDERS["rerun"](tmp_path / "a.rrd", ENV).start(episode)
    assert not (tmp_path / "a.rrd").exists()


def test_rerun_loads_only_when_asked():
    code = "import sys, sdfgcn.viz; sys.exit('rerun' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_size_of_a_long_episode(tmp_path):
    """30 pushes that each move an object, with noise for pictures: the worst there is."""
    rng = np.random.default_rng(0)
    steps = []
    for index in range(1, 31):
        moved = moment([(x, y - 0.01 * index) for x, y in START])
        noise = rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8)
        steps.append(replace(episode_steps()[0], index=index, after=replace(moved, pixels=noise)))
    record(tmp_path / "a.rrd", steps=steps)
    assert (tmp_path / "a.rrd").stat().st_size < 5e6
