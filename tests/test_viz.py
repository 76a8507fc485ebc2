"""Recordings, read back: what stands in the file is what the episode did."""

import io
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from moments import ENV, SIZE, START, cube, episode_start, episode_steps, moment, motion, record
from PIL import Image
from recordings import Recording

from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import RECORDERS
from sdfgcn.viz.colors import ILLEGAL_COLOR, STATUS_COLORS, object_colors, sdf_colors, value_colors
from sdfgcn.viz.heat_map import CELL, NAMES
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
        "/world/robot/base",
        "/world/robot/tool",
        "/world/push",
        "/world/expected",
        "/world/moved",
        "/world/table",
        "/world/bounds/spawn",
        "/world/bounds/range",
        "/world/camera",
        "/world/camera/picture",
        "/world/camera/masks",
        "/world/camera/names",
        "/world/camera/values",
        "/world/camera/push",
        "/world/camera/expected/moves",
        "/world/camera/expected/ring",
        "/world/camera/moved",
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
        "/q_values/heat_map",
        "/q_values/table",
        "/expected/scores",
        "/words",
        "/log",
        "/summary",
    }
    assert per_slot | contours | rest <= recording.entities()
    assert recording.timelines == {"push", "motion"}
    assert recording.pushes("/world/camera/picture") == [1, 2, 3]
    assert list(recording["/world/push", "Arrows3D:vectors"]) == [1, 2]
    for entity in ("/world/push", "/world/camera/values", "/world/camera/push"):
        assert list(recording[entity, "Clear:is_recursive"]) == [3]  # the end has no push


def test_edges_of_the_graph(recording):
    strips = np.array(recording["/world/camera/graph", "LineStrips2D:strips"][2])
    # Among objects, from the lower row to the higher one, then to goals, by row. Slot 0 (row 1)
    # reached its goal at push 1.
    slots = np.array([[36, 48], [48, 24], [72, 72]])  # projected centres of the slots
    goals = np.array([[36, 48], [48, 36], [72, 24]])
    expected = [
        *([slots[2], slots[0]], [slots[2], slots[1]], [slots[0], slots[1]]),
        *([slots[2], goals[2]], [slots[0], goals[0]], [slots[1], goals[1]]),
    ]
    np.testing.assert_allclose(strips, expected)
    colors = recording["/world/camera/graph", "LineStrips2D:colors"][2]
    white, grey = 0xFFFFFFFF, 0xA0A0A0FF
    assert colors == [grey, grey, grey, white, white, white]


def test_arrow_is_the_projected_push(recording):
    # 48 pixels to the metre from the middle (48, 48); v grows downwards.
    origins = recording["/world/camera/push", "Arrows2D:origins"]
    vectors = recording["/world/camera/push", "Arrows2D:vectors"]
    # The dark edge comes first.
    np.testing.assert_allclose(origins[1], [[24, 48]] * 2, atol=1e-5)
    np.testing.assert_allclose(vectors[1], [[36, -12]] * 2, atol=1e-5)
    np.testing.assert_allclose(recording["/world/push", "Arrows3D:vectors"][1], [[0.75, 0.25, 0]])


def test_a_blocked_push_is_drawn_as_it_was_meant(recording):
    """It never began; env.push.length is 0.5 m, and the direction is straight down."""
    origins = recording["/world/camera/push", "Arrows2D:origins"]
    vectors = recording["/world/camera/push", "Arrows2D:vectors"]
    np.testing.assert_allclose(origins[2], [[72, 12]] * 2, atol=1e-5)
    np.testing.assert_allclose(vectors[2], [[0, 24]] * 2, atol=1e-5)
    vectors = recording["/world/push", "Arrows3D:vectors"][2]
    np.testing.assert_allclose(vectors, [[0, -0.5, 0]], atol=1e-6)
    assert recording["/world/push", "Arrows3D:labels"][2] == ["blocked"]
    done, blocked = (packed(STATUS_COLORS[status]) for status in ("done", "blocked"))
    assert recording["/world/camera/push", "Arrows2D:colors"][1][1] == done
    assert recording["/world/camera/push", "Arrows2D:colors"][2][1] == blocked
    assert recording["/world/push", "Arrows3D:colors"][2] == [blocked]
    assert recording["/log", "TextLog:color"][1] == [done]
    assert recording["/log", "TextLog:color"][2] == [blocked]


def packed(color, alpha=255):
    red, green, blue = color
    return (red << 24) + (green << 16) + (blue << 8) + alpha


def test_the_robot_moves(recording):
    """Its meshes are logged once; it stands at the push, and in between on the other timeline."""
    vertices = recording["/world/robot/tool", "Mesh3D:vertex_positions"]
    assert list(vertices) == [None]
    np.testing.assert_allclose(vertices[None], cube("tool").vertices)
    still = recording["/world/robot/tool", "Transform3D:translation"]
    assert list(still) == [1, 3]  # push 2 has no motion
    np.testing.assert_allclose(still[1], [[-0.75, 0, 0]])  # down, where the push begins
    np.testing.assert_allclose(still[3], [[0, 0, 1]])
    moves = recording.motion["/world/robot/tool", "Transform3D:translation"]
    assert list(moves) == pytest.approx([1.0, 1.2, 1.4, 1.6, 1.8, 3.0])
    places = [cell[0] for cell in moves.values()]
    expected = [(0, 0, 1), *motion().links[:, 1, :3], (0, 0, 1)]
    np.testing.assert_allclose(places, expected, atol=1e-6)
    pushed = recording.motion["/world/objects/0", "Transform3D:translation"]
    assert sorted(pushed) == pytest.approx([1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 3.0])
    assert pushed[1.6][0][0] == pytest.approx(-0.25)


def test_expected_and_actual_displacements(recording):
    """Row 1, slot 0, is expected 24 pixels up in the picture and moves 12 to the right."""
    expected = recording["/world/camera/expected/moves", "Arrows2D:vectors"][1]
    np.testing.assert_allclose(expected, [[0, -24]] * 2, atol=1e-4)
    moved = recording["/world/camera/moved", "Arrows2D:vectors"][1]
    np.testing.assert_allclose(moved, [[12, 0]] * 2, atol=1e-4)
    ring = np.array(recording["/world/camera/expected/ring", "LineStrips2D:strips"][1][0])
    np.testing.assert_allclose(np.linalg.norm(ring - [24, 24], axis=1), 6.0, atol=1e-4)
    np.testing.assert_allclose(recording["/world/expected", "Arrows3D:vectors"][1], [[0, 0.5, 0]])
    np.testing.assert_allclose(recording["/world/moved", "Arrows3D:vectors"][1], [[0.25, 0, 0]])
    assert recording["/world/moved", "Arrows3D:colors"][1] == [packed((255, 0, 0))]  # slot 0
    # What came of the push is shown once it is over.
    assert sorted(recording.motion["/world/moved", "Arrows3D:vectors"]) == pytest.approx([1.9, 2.9])
    assert sorted(recording.motion["/world/expected", "Arrows3D:vectors"]) == [1.0]
    scores = recording["/expected/scores", "TextDocument:text"][1][0].splitlines()
    assert scores[0] == "| push | value | risk |"
    # Row 2 has the highest values, but its risk was not weighed; direction 2 is not legal.
    assert scores[2] == "| #1 green ↘ 315° | 23.00 |  |"
    assert "**Expected**: #0 red 500 ± 125 mm" in recording["/words", "TextDocument:text"][1][0]


def test_values_around_the_objects(recording):
    """An arrow for each of the 21 legal pushes; the chosen one is white, the best the longest."""
    vectors = np.array(recording["/world/camera/values", "Arrows2D:vectors"][1])
    colors = recording["/world/camera/values", "Arrows2D:colors"][1]
    assert len(vectors) == len(colors) == 21
    assert [k for k, color in enumerate(colors) if color == packed((255, 255, 255))] == [7 + 1]
    lengths = np.linalg.norm(vectors, axis=1)
    assert (np.diff(lengths) > 0).all()  # values count up from row to row
    assert vectors[0, 0] > 0 == round(vectors[0, 1], 5)  # direction 0 is to the right


def test_heat_map(recording):
    """Cells have the colours of one scale for the episode; names and directions are drawn."""
    blob = recording["/q_values/heat_map", "EncodedImage:blob"][1][0]
    picture = np.asarray(Image.open(io.BytesIO(bytes(blob))))
    width, height = CELL
    assert picture.shape == ((3 + 2) * height, NAMES + 8 * width, 3)

    def corner(row, k):  # clear of the number and the frame
        return picture[(row + 1) * height + 5, NAMES + k * width + 5]

    scale = value_colors(np.arange(24.0), 0.0, 23.0)
    np.testing.assert_array_equal(corner(0, 0), scale[0])
    np.testing.assert_array_equal(corner(2, 7), scale[23])
    np.testing.assert_array_equal(corner(1, 2), ILLEGAL_COLOR)
    assert (picture[2 * height + 2, NAMES + width + 10] == 255).all()  # the frame of the chosen
    for row, slot in enumerate([2, 0, 1]):
        name = picture[(row + 1) * height : (row + 2) * height, :NAMES].reshape(-1, 3)
        assert (name == object_colors(episode_start())[slot]).all(axis=1).any()
    for k in range(8):  # arrows
        assert (picture[:height, NAMES + k * width : NAMES + (k + 1) * width] > 200).any()


def test_pictures_and_masks(recording):
    for entity, push, value in [
        ("/world/camera/picture", 1, 100),
        ("/world/camera/picture", 3, 101),
        ("/goal/picture", None, 50),
    ]:
        blob = recording[entity, "EncodedImage:blob"][push][0]
        picture = np.asarray(Image.open(io.BytesIO(bytes(blob))))
        assert picture.shape == (SIZE, SIZE, 3)
        assert (picture == value).all()
    # Classes go by slot (from 1), whatever the order of the rows.
    labels = recording["/world/camera/masks", "SegmentationImage:buffer"][1][0]
    labels = np.array(labels, dtype=np.uint8).reshape(SIZE, SIZE)
    assert [labels[48, 24], labels[24, 48], labels[72, 72], labels[0, 0]] == [1, 2, 3, 0]
    classes = recording["/", "AnnotationContext:context"][None][0]
    names = {entry["class_description"]["info"]["label"] for entry in classes}
    assert {"#0 red", "#1 green", "#2 blue"} <= names


def test_sdfs_are_drawn_when_they_change(recording):
    assert [recording.pushes(f"/sdf/scene/{slot}") for slot in range(3)] == [[1, 2], [1], [1]]
    blob = recording["/sdf/scene/0", "EncodedImage:blob"][2][0]
    drawn = np.asarray(Image.open(io.BytesIO(bytes(blob))))
    np.testing.assert_array_equal(drawn, sdf_colors(episode_steps()[0].after.scene.sdf[1].numpy()))
    # Slot 0 lies at (36, 48) now; its mask is 10 pixels wide. Corners are cut between pixels.
    contour = np.concatenate(recording["/sdf/scene/0/contour", "LineStrips2D:strips"][2])
    np.testing.assert_allclose(contour.min(axis=0), [31, 43], atol=0.05)
    np.testing.assert_allclose(contour.max(axis=0), [41, 53], atol=0.05)


def test_inside_and_outside_of_an_sdf_differ():
    """Red inside and blue outside, on a scale that ends at half the picture: 48 pixels."""
    field = np.full((SIZE, SIZE), 48.0)
    field[0, :4] = [-0.01, 0.01, -48.0, 96.0]
    colors = sdf_colors(field).astype(int)
    inside, outside = colors[0, 0], colors[0, 1]
    assert inside[0] > inside[2] + 100  # at the contour too
    assert outside[2] > outside[0]
    assert colors[0, 2].tolist() == [165, 0, 38]
    assert colors[0, 3].tolist() == colors[1, 1].tolist() == [49, 54, 149]


def test_poses_and_meshes(recording):
    moves = recording["/world/objects/0", "Transform3D:translation"]
    np.testing.assert_allclose(moves[1], [[-0.5, 0, 0]])
    np.testing.assert_allclose(moves[2], [[-0.25, 0, 0]])
    quaternion = recording["/world/objects/0", "Transform3D:quaternion"][1]  # w comes last
    np.testing.assert_allclose(quaternion, [[0, 0, np.sqrt(0.5), np.sqrt(0.5)]], rtol=1e-6)
    goals = recording["/world/goal/2", "Transform3D:translation"]
    np.testing.assert_allclose(goals[None], [[0.5, 0.5, 0]])
    vertices = recording["/world/objects/0", "Mesh3D:vertex_positions"][None]
    np.testing.assert_allclose(vertices, cube("red").vertices)
    assert recording["/world/objects/0", "Mesh3D:albedo_factor"][None] == [0xFF0000FF]
    assert ("/world/objects/1", "Mesh3D:albedo_texture_buffer") in recording.values
    alpha = recording["/world/goal/1", "Mesh3D:albedo_factor"][None][0] & 0xFF
    assert 0 < alpha < 255


def test_an_object_has_one_colour(recording):
    """Slot 0 is red; slot 1 has a texture, so its colour comes from the palette."""
    colors = object_colors(episode_start())
    assert colors[0] == (255, 0, 0)
    classes = {
        entry["class_id"]: entry["class_description"]["info"]["color"]
        for entry in recording["/", "AnnotationContext:context"][None][0]
    }
    for slot, row in ((0, 1), (1, 2), (2, 0)):  # the rows of the first moment
        color = packed(colors[slot])
        assert classes[slot + 1] == color
        assert recording["/world/camera/names", "Points2D:colors"][1][row] == color
        assert recording["/world/camera/names", "Points2D:labels"][1][row] == f"#{slot}"
        assert recording[f"/sdf/scene/{slot}/contour", "LineStrips2D:colors"][1][-1] == color
        assert recording[f"/distance/{slot}", "SeriesLines:colors"][None] == [color]
        ghost = recording[f"/world/goal/{slot}", "Mesh3D:albedo_factor"][None][0]
        assert ghost >> 8 == color >> 8
    assert recording["/world/objects/2", "Mesh3D:albedo_factor"][None] == [packed(colors[2])]
    outlines = recording["/world/camera/goal", "LineStrips2D:colors"][None]
    assert {packed(color) for color in colors} <= set(outlines)


@pytest.mark.parametrize("n", [8, 12])
def test_colours_of_many_objects_differ(n):
    episode = episode_start(known=False)
    colors = object_colors(replace(episode, n_objects=n))
    assert len(set(colors[:8])) == 8


def test_figures(recording):
    def series(entity):
        return {push: cell[0] for push, cell in recording[entity, "Scalars:scalars"].items()}

    assert series("/distance/0") == {1: 0.25, 2: 0.0, 3: 0.0}
    assert series("/distance/2") == {1: 1.0, 2: 1.0, 3: 1.0}
    assert series("/distance/threshold") == {1: 0.05, 2: 0.05, 3: 0.05}
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
    assert title == "#0 red towards 45 degrees: number 13 by value of 21 legal pushes."
    assert head.startswith("| object | → | ↗ | ↑ |")
    assert [row.split(" | ")[:4] for row in rows] == [
        ["| #2 blue", "0.00", "1.00", "(2.00)"],
        ["| #0 red", "8.00", "**9.00**", "(10.00)"],
        ["| #1 green", "16.00", "17.00", "(18.00)"],
    ]
    assert note == "Bold: the push. In brackets: not legal."
    assert texts[2][0].splitlines()[0].startswith("#2 blue towards 270 degrees: number 16 by value")


def test_the_highest_q_value():
    first, _ = episode_steps()
    best = replace(first, q_values=-np.abs(np.arange(32.0).reshape(4, 8) - 9))
    told = q_table(["a", "b", "c"], best)
    assert told.startswith("b towards 45 degrees: the highest value of 21 legal pushes.")


def test_words(recording):
    log = {push: cell[0] for push, cell in recording["/log", "TextLog:text"].items()}
    assert log[1].startswith("Done: #0 red towards 45 degrees")  # row 1 shows slot 0
    assert log[3] == "Step limit after 2 pushes."
    words = recording["/words", "TextDocument:text"][1][0]
    assert words.startswith("### Push 1: #0 red towards 45 degrees: done")
    assert "**Moved**: #0 red 250 mm." in words
    assert "**To the goal (mm)**: #0 250 → 0, #1 250 → 250, #2 1000 → 1000." in words
    assert "**Reward** +7.48: progress +7.50, step -0.02." in words
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
    assert recording["/sdf/scene/0", "Clear:is_recursive"] == {2: [True]}
    assert recording["/sdf/scene/1", "Clear:is_recursive"] == {3: [True]}
    labels = recording["/world/camera/masks", "SegmentationImage:buffer"][3][0]
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
    assert Recording(path).pushes("/words") == [1, 2, 3]


def test_recorders_do_not_mix(tmp_path):
    import rerun

    with RECORDERS["rerun"](tmp_path / "a.rrd", ENV) as a:
        a.start(episode_start(seed=1))
        with RECORDERS["rerun"](tmp_path / "b.rrd", ENV) as b:
            b.start(episode_start(seed=2))
            a.step(episode_steps()[0])
    assert rerun.get_global_data_recording() is None
    assert Recording(tmp_path / "a.rrd").pushes("/words") == [1, 2]
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
