"""Recordings, read back: what stands in the file is what the episode did."""

import io
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import skfmm
from PIL import Image
from recordings import Recording
from sdfgcn.envs.types import EpisodeStart, Scene, StepRecord
from sdfgcn.sim.types import Push
from sdfgcn.viz.geometry import edge_strips, node_slots, vertex_normals, zero_contour

from sdfgcn.config import ArenaConfig, EnvConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.geometry.camera import CameraModel
from sdfgcn.objects.model import ObjectModel, Rest
from sdfgcn.registry import RECORDERS
from sdfgcn.viz.words import q_table

SIZE = 96
# 1 m above the table with 90 degrees of view: 48 pixels to the metre, (0, 0) in the middle.
CAMERA = CameraModel(np.array([0.0, 0.0, 1.0]), np.eye(3), fovy=np.pi / 2, size=SIZE)
START = [(-0.5, 0.0), (0.0, 0.5), (0.5, -0.5)]  # m, in slot order
GOAL = [(-0.25, 0.0), (0.0, 0.25), (0.5, 0.5)]
NODE_ORDER = [2, 0, 1]  # slot of each node: detections come in any order
ENV = EnvConfig(
    success_threshold=0.05,
    arena=ArenaConfig(
        spawn_x=[-0.6, 0.6],
        spawn_y=[-0.6, 0.6],
        range_x=[-0.8, 0.8],
        range_y=[-0.8, 0.8],
        reach_x=[-0.9, 0.9],
        reach_y=[-0.9, 0.9],
    ),
)


def cube(name: str, half: float = 0.1, textured: bool = False) -> ObjectModel:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    vertices = (half * corners).astype(np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], dtype=np.int32)
    return ObjectModel(
        name=name,
        category="block",
        split="test",
        vertices=vertices,
        faces=faces,
        uv=np.zeros((8, 2), np.float32) if textured else None,
        texture=np.full((4, 4, 3), 200, np.uint8) if textured else None,
        pieces=(vertices,),
        mass=0.1,
        rests=(Rest((1.0, 0.0, 0.0, 0.0), half, 1.4143 * half, 1.0),),
    )


def scene(positions, order=NODE_ORDER, value=100) -> Scene:
    """Square masks, 10 pixels wide, round the objects' projected centres."""
    masks = np.zeros((len(order), SIZE, SIZE), dtype=bool)
    for node, slot in enumerate(order):
        u, v = np.round(CAMERA.project([*positions[slot], 0.0])).astype(int)
        masks[node, v - 5 : v + 5, u - 5 : u + 5] = True
    sdf = np.array([skfmm.distance(0.5 - mask) for mask in masks], dtype=np.float32)
    poses = np.array([[x, y, 0.0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)] for x, y in positions])
    pixels = np.full((SIZE, SIZE, 3), value, dtype=np.uint8)
    matched = np.array(order, dtype=np.int64)  # the goal's nodes come in slot order
    return Scene(pixels, masks, sdf.reshape(-1, SIZE, SIZE), poses, matched)


def episode_start(seed: int = 7) -> EpisodeStart:
    return EpisodeStart(
        seed=seed,
        objects=(cube("red"), cube("green", textured=True), cube("blue")),
        colors=np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1.0]]),
        scene=scene(START),
        goal=scene(GOAL, order=[0, 1, 2], value=50),
        camera=CAMERA,
    )


def episode_steps() -> list[StepRecord]:
    """Push 1 moves slot 0 to its goal; push 2 is blocked."""
    after = scene([GOAL[0], *START[1:]], value=101)
    first = Push(1, 1, np.array([-0.5, 0, 0]), np.array([0.25, 0.25, 0]), "done")
    second = Push(0, 6, np.array([0.5, 0.75, 0]), np.array([0.5, 0.25, 0]), "blocked")
    q_values = np.arange(32, dtype=np.float32).reshape(4, 8)  # the fourth node is padding
    legal = q_values % 8 != 2
    common = {"out_of_range": False, "q_values": q_values, "scene": after, "success": False}
    common["legal"] = legal
    return [
        StepRecord(
            index=1,
            push=first,
            distances=np.array([0.0, 0.25, 1.0]),
            reward_terms={"progress": 7.5, "step": -0.02},
            reward=7.48,
            terminated=False,
            truncated=False,
            **common,
        ),
        StepRecord(
            index=2,
            push=second,
            distances=np.array([0.0, 0.25, 1.0]),
            reward_terms={"progress": 0.0, "step": -0.02},
            reward=-0.02,
            terminated=False,
            truncated=True,
            **common,
        ),
    ]


def record(path, episode=None, steps=None, name="rerun") -> None:
    with RECORDERS[name](path, ENV) as recorder:
        recorder.start(episode or episode_start())
        for step in episode_steps() if steps is None else steps:
            recorder.step(step)


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
    assert [entry.name for entry in tmp_path.iterdir()] == ([] if name == "none" else [path.name])


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
    # Each edge from the lower node to the higher one; slot 0 (node 1) reached its goal at push 1.
    slots = np.array([[36, 48], [48, 24], [72, 72]])  # projected centres of the slots
    goals = np.array([[36, 48], [48, 36], [72, 24]])
    expected = [
        *([slots[2], slots[0]], [slots[2], slots[1]], [slots[2], goals[2]]),
        *([slots[0], slots[1]], [slots[0], goals[0]], [slots[1], goals[1]]),
    ]
    np.testing.assert_allclose(strips, expected)
    colors = recording["/world/camera/graph", "LineStrips2D:colors"][1]
    white, grey = 0xFFFFFFFF, 0xA0A0A0FF
    assert colors == [grey, grey, white, grey, white, white]


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
    # Classes go by slot (from 1), whatever the order of the nodes.
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
    np.testing.assert_allclose(drawn, episode_steps()[0].scene.sdf[1], atol=0.04)
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
    assert q_values["shape"] == [3, 8]  # three nodes; padding is left out


def test_q_values_in_words(recording):
    texts = recording["/q_values/table", "TextDocument:text"]
    title, _, head, _, *rows, _, note = texts[1][0].splitlines()
    # Node 1 shows slot 0. Values count up to 23 from node to node; direction 2 is not legal.
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
    told = q_table(["a", "b", "c"], replace(best, legal=None))
    assert told.startswith("b towards 45 degrees: the highest Q-value of 24 legal pushes.")


def test_words(recording):
    log = {push: cell[0] for push, cell in recording["/log", "TextLog:text"].items()}
    assert log[1].startswith("#0 red towards 45 degrees: done")  # node 1 shows slot 0
    summary = recording["/summary", "TextDocument:text"][None][0]
    assert "Seed 7: step limit" in summary
    assert "| #2 blue | block | 1000 |" in summary


def test_layout_comes_with_the_file(recording):
    assert recording.blueprints == recording.applications == {"sdfgcn 3 objects"}


def test_objects_that_vanish_and_false_detections(tmp_path):
    first, second = episode_steps()
    vanished = scene(START, order=[2, 1])
    ghost = scene([(-0.9, -0.9), *START[1:]], order=[0])
    ghost = replace(ghost, poses=vanished.poses)  # a mask where no object lies
    steps = [replace(first, scene=vanished), replace(second, scene=ghost, q_values=None)]
    record(tmp_path / "a.rrd", steps=steps)
    recording = Recording(tmp_path / "a.rrd")
    assert recording["/sdf/scene/0", "Clear:is_recursive"] == {1: [True]}
    assert recording["/sdf/scene/1", "Clear:is_recursive"] == {2: [True]}
    labels = recording["/world/camera/masks", "SegmentationImage:buffer"][2][0]
    assert set(labels) == {0, 4}  # 4: "unmatched"


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
    episode = replace(episode, scene=replace(episode.scene, pixels=None))
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
        moved = scene([(x, y - 0.01 * index) for x, y in START])
        noise = rng.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8)
        steps.append(replace(episode_steps()[0], index=index, scene=replace(moved, pixels=noise)))
    record(tmp_path / "a.rrd", steps=steps)
    assert (tmp_path / "a.rrd").stat().st_size < 5e6


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


def test_edges_leave_out_hidden_and_unmatched_nodes():
    goal = scene(GOAL, order=[0, 1, 2])
    goal.masks[1] = False  # hidden in the goal
    current = replace(scene(START, order=[0, 1, 2]), correspondence=np.array([-1, 1, 2]))
    current.masks[0] = False
    strips, to_goal = edge_strips(current, goal)
    np.testing.assert_allclose(strips, [[[48, 24], [72, 72]], [[72, 72], [72, 24]]])
    np.testing.assert_array_equal(to_goal, [False, True])
    nothing, _ = edge_strips(scene(START, order=[]), goal)
    assert nothing.shape == (0, 2, 2)


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1], [1], []])
def test_node_slots(order):
    slots = node_slots(scene(START, order), np.full(3, 0.17), CAMERA)
    np.testing.assert_array_equal(slots, order)


def test_node_slots_with_an_object_out_of_the_world():
    fallen = scene(START)
    fallen.poses[0, 2] = 2.0  # above the camera
    slots = node_slots(fallen, np.full(3, 0.17), CAMERA)
    np.testing.assert_array_equal(slots, [2, -1, 1])
