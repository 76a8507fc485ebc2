"""An episode of three cubes on a table, laid out by hand, as an environment reports it."""

from dataclasses import replace

import numpy as np
from configs import real_config

from sdfgcn.config import VizConfig
from sdfgcn.envs.records import EpisodeStart, Push, Snapshot, StepRecord
from sdfgcn.objects.model import ObjectModel, Rest
from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.registry import RECORDERS
from sdfgcn.task.camera import CameraModel
from sdfgcn.task.explanation import Explanation
from sdfgcn.task.scene import Detections, Scene
from sdfgcn.task.world import Motion, PushResult, RobotLink, RobotShape, Truth

SIZE = 96
ROWS = 4  # of every scene; the last is always empty
# 1 m above the table with 90 degrees of view: 48 pixels to the metre, (0, 0) in the middle.
CAMERA = CameraModel(np.array([0.0, 0.0, 1.0]), np.eye(3), fovy=np.pi / 2, size=SIZE)
START = [(-0.5, 0.0), (0.0, 0.5), (0.5, -0.5)]  # m, in slot order
GOAL = [(-0.25, 0.0), (0.0, 0.25), (0.5, 0.5)]
ORDER = [2, 0, 1]  # slot of each row: rows come in any order
_REAL = real_config("objects=household", "robot=gripper").env
ENV = replace(
    _REAL,
    success_threshold=0.05,
    push=replace(_REAL.push, length=0.5, plane_height=0.0),
    arena=replace(
        _REAL.arena,
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


def moment(positions, order=ORDER, value=100, known=True, matched=None) -> Snapshot:
    """Square masks, 10 pixels wide, round the objects' projected centres.

    `order` has the slot of each row, None for an empty one.
    """
    found = np.array([slot is not None for slot in order], dtype=bool)
    slots = [slot for slot in order if slot is not None]
    masks = np.zeros((len(slots), SIZE, SIZE), dtype=bool)
    for node, slot in enumerate(slots):
        u, v = np.round(CAMERA.project([*positions[slot], 0.0])).astype(int)
        masks[node, v - 5 : v + 5, u - 5 : u + 5] = True
    center = np.array(positions, dtype=float)[slots].reshape(-1, 2)
    sdf = SdfTransform("fmm", SIZE).fields(masks)
    shown = Scene.of(Detections(masks, sdf, center, center), found, ROWS, SIZE)
    poses = np.array([[x, y, 0.0, np.sqrt(0.5), 0, 0, np.sqrt(0.5)] for x, y in positions])
    pixels = np.full((SIZE, SIZE, 3), value, dtype=np.uint8)
    rows = shown.node_mask.numpy() if matched is None else np.array(matched)
    return Snapshot(shown, rows, pixels, poses if known else None)


def robot() -> RobotShape:
    """A base that stays and a tool that hangs 1 m above the middle of the table."""
    links = tuple(
        RobotLink(name, model.vertices, model.faces, np.full((8, 3), 120, np.uint8))
        for name, model in (("base", cube("base")), ("tool", cube("tool")))
    )
    return RobotShape(links, poses_at([0, -1, 0], [0, 0, 1]))


def poses_at(*places) -> np.ndarray:
    """[n, 7] poses without rotation."""
    return np.hstack([np.array(places, float), np.tile([1.0, 0, 0, 0], (len(places), 1))])


def motion() -> Motion:
    """The tool comes down at (-0.75, 0) and pushes slot 0 to its goal."""
    tool = [(-0.75, 0, 0.5), (-0.75, 0, 0), (-0.5, 0, 0), (-0.4, 0, 0.5)]
    moved = [-0.5, -0.5, -0.25, -0.25]
    return Motion(
        phases=("descent", "push", "push", "lift"),
        joints=np.array([[*place, 0.0] for place in tool]),
        links=np.array([poses_at([0, -1, 0], place) for place in tool]),
        objects=np.array([moment([(x, 0.0), *START[1:]]).poses for x in moved]),
    )


def explanation() -> Explanation:
    """Row 1 is expected to move 0.5 m up in the picture, give or take 0.125 m."""
    displacement = np.zeros((ROWS, 2), np.float32)
    displacement[1] = [0.0, 0.5]
    risk = np.full((ROWS, 8), np.nan, np.float32)
    risk[:2] = 0.25
    return Explanation(displacement, np.full(ROWS, 0.125, np.float32), {"risk": risk})


def episode_start(seed: int = 7, known: bool = True) -> EpisodeStart:
    goal = moment(GOAL, value=50, known=known)
    truth = Truth(
        objects=(cube("red"), cube("green", textured=True), cube("blue")),
        colors=np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0, 0, 1, 1.0]]),
        goal_poses=moment(GOAL).poses,
    )
    return EpisodeStart(
        seed=seed,
        n_objects=3,
        truth=truth if known else None,
        start=moment(START, known=known),
        goal=goal,
        camera=CAMERA,
        robot=robot() if known else None,
    )


def episode_steps(known: bool = True) -> list[StepRecord]:
    """Push 1 moves slot 0 to its goal; push 2 is blocked."""
    after = moment([GOAL[0], *START[1:]], value=101, known=known)
    stop, course = np.array([0.5, 0.75, 0]), motion() if known else None
    first = PushResult("done", np.array([-0.5, 0, 0]), np.array([0.25, 0.25, 0]), course)
    second = PushResult("blocked", stop, stop)
    q_values = np.arange(32, dtype=np.float32).reshape(ROWS, 8)
    common = {"out_of_range": False, "q_values": q_values, "after": after, "success": False}
    common |= {"legal": q_values % 8 != 2, "distances": np.array([0.0, 0.25, 1.0])}
    return [
        StepRecord(
            index=1,
            push=Push(row=1, direction=1, angle=np.pi / 4, result=first),
            reward_terms={"progress": 7.5, "step": -0.02},
            reward=7.48,
            terminated=False,
            truncated=False,
            explanation=explanation(),
            **common,
        ),
        StepRecord(
            index=2,
            push=Push(row=0, direction=6, angle=3 * np.pi / 2, result=second),
            reward_terms={"progress": 0.0, "step": -0.02},
            reward=-0.02,
            terminated=False,
            truncated=True,
            **common,
        ),
    ]


def viz_of(name: str) -> VizConfig:
    """The config of a recorder; a film is small and short."""
    viz = real_config(f"viz={name}").viz
    small = {"width": 200, "height": 160, "push_frames": 3, "jump_frames": 1, "hold": 0.25}
    return replace(viz, **{key: value for key, value in small.items() if hasattr(viz, key)})


def record(path, episode=None, steps=None, name="rerun") -> None:
    """Write a recording of this episode, or of another."""
    with RECORDERS[name](path, ENV, viz_of(name)) as recorder:
        recorder.start(episode or episode_start())
        for step in episode_steps() if steps is None else steps:
            recorder.step(step)
