"""Recordings of a world without truth, and the shapes that drawing needs."""

from dataclasses import replace

import numpy as np
import pytest
from moments import (
    CAMERA,
    GOAL,
    ROWS,
    SIZE,
    START,
    cube,
    episode_start,
    episode_steps,
    moment,
    record,
)
from recordings import Recording

from sdfgcn.viz.shapes import edge_strips, row_slots, vertex_normals, zero_contour

# ------------------------------------------------------------------ a world without truth


@pytest.fixture(scope="module")
def unknown(tmp_path_factory):
    """A recording of what a camera alone knows: rows stand for objects."""
    path = tmp_path_factory.mktemp("unknown") / "a.rrd"
    steps = [
        replace(step, distances=np.array([1.0, 0.0, np.nan, np.nan]))
        for step in episode_steps(known=False)
    ]
    record(path, episode_start(known=False), steps)
    return Recording(path)


def test_without_truth_there_are_pictures_and_no_meshes(unknown):
    drawn = unknown.entities()
    assert not any(entity.startswith(("/world/objects", "/world/goal")) for entity in drawn)
    assert {"/world/camera/picture", "/goal/picture", "/world/push", "/log"} <= drawn
    labels = unknown["/world/camera/masks", "SegmentationImage:buffer"][1][0]
    labels = np.array(labels, dtype=np.uint8).reshape(SIZE, SIZE)
    assert [labels[48, 24], labels[24, 48], labels[72, 72]] == [2, 3, 1]  # by row, from 1
    assert unknown["/distance/0", "Scalars:scalars"] == {1: [1.0], 2: [1.0], 3: [1.0]}
    # Seen at the start, and not matched any more after a push.
    assert unknown["/distance/2", "Scalars:scalars"] == {1: [0.25]}


def test_without_truth_words_go_by_row(unknown):
    log = {push: cell[0] for push, cell in unknown["/log", "TextLog:text"].items()}
    assert log[1].startswith("Done: #1 towards 45 degrees")
    summary = unknown["/summary", "TextDocument:text"][None][0]
    assert "Errors: between the centres that were seen." in summary
    assert "| #0 |  | 1000 |" in summary
    assert "| #2 |  |  |" in summary  # not matched, so not known


def test_without_truth_more_rows_than_objects(tmp_path):
    """A false detection in the fourth row has no object's name and colour."""
    positions = [*START, (-0.5, -0.5)]
    start = replace(episode_start(known=False), start=moment(positions, [2, 0, 1, 3], known=False))
    record(tmp_path / "a.rrd", start, steps=episode_steps(known=False))
    recording = Recording(tmp_path / "a.rrd")
    labels = recording["/world/camera/masks", "SegmentationImage:buffer"][1][0]
    assert np.array(labels, dtype=np.uint8).reshape(SIZE, SIZE)[72, 24] == 4  # "unmatched"
    assert not any(entity.startswith("/sdf/scene/3") for entity in recording.entities())
    text = recording["/q_values/table", "TextDocument:text"][1][0]
    assert "| row 3 | " in text


# ------------------------------------------------------------------ shapes


def test_zero_contour_of_a_disc():
    v, u = np.mgrid[:32, :40] + 0.5
    (contour,) = zero_contour(np.hypot(u - 20, v - 12) - 8)
    radii = np.hypot(*(contour - [20, 12]).T)
    np.testing.assert_allclose(radii, 8, atol=0.02)
    assert zero_contour(np.ones((8, 8))) == []


def test_vertex_normals_of_a_cube():
    model = cube("a")
    normals = vertex_normals(model.vertices, model.faces)
    outwards = model.vertices / np.linalg.norm(model.vertices, axis=1, keepdims=True)
    assert (np.sum(normals * outwards, axis=1) > 0.9).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-5)
    lone = vertex_normals(np.zeros((1, 3)), np.zeros((0, 3), dtype=int))
    np.testing.assert_array_equal(lone, [[0, 0, 0]])


def test_edges_leave_out_hidden_and_unmatched_rows():
    goal = moment(GOAL, order=[0, None, 2])  # slot 1 is hidden in the goal
    current = moment(START, order=[None, 1, 2], matched=[False, False, True, False])
    strips, to_goal = edge_strips(current, goal)
    np.testing.assert_allclose(strips, [[[48, 24], [72, 72]], [[72, 72], [72, 24]]])
    np.testing.assert_array_equal(to_goal, [False, True])
    nothing, _ = edge_strips(moment(START, order=[]), goal)
    assert nothing.shape == (0, 2, 2)


RADII = np.full(3, 0.17)


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1], [1], [], [None, 2, None, 0]])
def test_row_slots(order):
    slots = row_slots(moment(START, order), RADII, CAMERA)
    padded = [*order, *[None] * (ROWS - len(order))]
    np.testing.assert_array_equal(slots, [-1 if slot is None else slot for slot in padded])


def test_row_slots_with_an_object_out_of_the_world():
    fallen = moment(START)
    fallen.poses[0, 2] = 2.0  # above the camera
    np.testing.assert_array_equal(row_slots(fallen, RADII, CAMERA), [2, -1, 1, -1])
