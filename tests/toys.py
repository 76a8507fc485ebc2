"""A catalogue of plain bodies whose sizes are known, and episodes laid out by hand."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import torch
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from tensordict import TensorDictBase

from sdfgcn.config import EnvConfig
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.objects.model import ObjectModel, Rest
from sdfgcn.objects.primitives import circle
from sdfgcn.sim.episode import EpisodeSpec
from sdfgcn.sim.world import MujocoWorld
from sdfgcn.task.world import PushCommand, PushResult

IDENTITY = (1.0, 0.0, 0.0, 0.0)
ON_ITS_SIDE = (0.5**0.5, 0.5**0.5, 0.0, 0.0)  # a quarter turn about x
BOX, SLAB, BALL, CAN = range(4)  # indices into TOYS
FAR = (0.30, 0.35)


def toy(name: str, points: np.ndarray, rest: tuple = IDENTITY, mass: float = 0.05) -> ObjectModel:
    """A convex body that rests in one pose; `points` are centred on its centre of mass."""
    hull = ConvexHull(points)
    # Outward faces: the order of a hull's triangles is arbitrary.
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flip = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    faces = np.where(flip[:, None], hull.simplices[:, ::-1], hull.simplices)
    height = -points[:, 1].min() if rest == ON_ITS_SIDE else -points[:, 2].min()
    return ObjectModel(
        name=name,
        category=name,
        split="test",
        vertices=points.astype(np.float32),
        faces=faces.astype(np.int32),
        uv=None,
        texture=None,
        pieces=(points.astype(np.float32),),
        mass=mass,
        rests=(Rest(rest, float(height), float(np.linalg.norm(points, axis=1).max()), 1.0),),
    )


def box_points(x: float, y: float, z: float) -> np.ndarray:
    """[8, 3] corners of a box with these edges, metres."""
    signs = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    return 0.5 * signs * [x, y, z]


def ball_points(radius: float) -> np.ndarray:
    """[200, 3] points spread evenly over a sphere."""
    k = np.arange(200) + 0.5
    polar, around = np.arccos(1 - 2 * k / 200), np.pi * (1 + 5**0.5) * k
    rings = np.sin(polar)
    return radius * np.stack([rings * np.cos(around), rings * np.sin(around), np.cos(polar)], -1)


def can_points(radius: float, height: float) -> np.ndarray:
    """[64, 3] two rims of 32 points, upright."""
    rim = circle(radius, 32)
    return np.concatenate(
        [np.column_stack([rim, np.full(32, h)]) for h in (-height / 2, height / 2)]
    )


TOYS = (
    toy("box", box_points(0.06, 0.06, 0.04)),
    toy("slab", box_points(0.10, 0.06, 0.02)),
    toy("ball", ball_points(0.03)),
    toy("can", can_points(0.03, 0.08), rest=ON_ITS_SIDE),
)


def toy_env(config: EnvConfig) -> RearrangementEnv:
    """An environment whose catalogue is TOYS."""
    return RearrangementEnv(config, seed=0, world=MujocoWorld(config, TOYS))


def lay_out(
    env: RearrangementEnv,
    objects: Sequence[int],
    start: Sequence[tuple[float, float]],
    goal: Sequence[tuple[float, float]] | None = None,
    yaw: float = 0.0,
) -> TensorDictBase:
    """Begin an episode with objects of the catalogue at [n] points, in their first rest.

    Args:
        env: Where.
        objects: Indices into the catalogue.
        start: Metres.
        goal: Metres; where nothing is pushed to if None: the far corner of the allowed region.
        yaw: Turns every object, radians.
    """
    rests = [env.world.catalogue[i].rests[0] for i in objects]
    turn = Rotation.from_euler("z", yaw)
    upright = [
        [
            rest.height,
            *(turn * Rotation.from_quat(rest.quat, scalar_first=True)).as_quat(scalar_first=True),
        ]
        for rest in rests
    ]
    episode = EpisodeSpec(
        seed=0,
        objects=np.array(objects),
        start=np.hstack([start, upright]),
        goal=np.hstack([[FAR] * len(objects) if goal is None else goal, upright]),
        colors=np.tile([0.8, 0.1, 0.1, 1.0], (len(objects), 1)),
    )
    return begin(env, episode)


def begin(env: RearrangementEnv, episode: EpisodeSpec) -> TensorDictBase:
    """Begin any episode, also one that the environment's own scenario would not draw."""
    drawn = {key: np.asarray(value).tolist() for key, value in asdict(episode).items()}
    return env.restore_state(
        {
            "world": {"episode": drawn, "poses": drawn["start"]},
            "seed": episode.seed,
            "pushes": 0,
            "rng": np.random.default_rng(0).bit_generator.state,
        }
    )


@dataclass(frozen=True)
class Pushed:
    """A push at hand-picked coordinates and what it did; [n, 7] poses."""

    result: PushResult
    before: np.ndarray
    after: np.ndarray

    @property
    def moved(self) -> np.ndarray:
        """[n, 3] metres."""
        return (self.after - self.before)[:, :3]


def angle_of(direction: int) -> float:
    """Where one of 8 directions heads, radians counter-clockwise from the x axis."""
    return direction * np.pi / 4


def ahead_of(direction: int) -> np.ndarray:
    """[2] the unit vector of one of 8 directions."""
    return np.array([np.cos(angle_of(direction)), np.sin(angle_of(direction))])


def push(env: RearrangementEnv, start: Sequence[float], direction: int, free: float) -> Pushed:
    """Push from `start` [2] whatever the picture says, past the planning of the environment."""
    before = env.world.poses()
    result = env.world.execute(PushCommand(np.array(start), angle_of(direction), free))
    return Pushed(result, before, env.world.poses())


def act(env: RearrangementEnv, td: TensorDictBase, action: int) -> TensorDictBase:
    """Take one step; what the env returns under "next"."""
    return env.step(td.clone().set("action", action))["next"]


def leaves(td: TensorDictBase) -> dict[str | tuple[str, ...], torch.Tensor]:
    """A copy of every tensor of an observation, by its key."""
    return {key: td[key].clone() for key in td.keys(include_nested=True, leaves_only=True)}


def assert_equal(td: TensorDictBase, other: TensorDictBase) -> None:
    """Every tensor of an observation, bit for bit; `other` may hold more."""
    for key, value in leaves(td).items():
        assert torch.equal(value, other[key]), key
