"""Stable resting poses, found by dropping an object in MuJoCo and letting it settle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from sdfgcn.config import ObjectsConfig
from sdfgcn.objects.model import Rest

SAME_FACE = np.deg2rad(15.0)  # down directions closer than this count as the same face
TIMESTEP = 0.002  # s
SOLREF = (0.005, 1.0)  # with softer contacts, flat faces jitter on three points forever
STILL_SECONDS = 0.1  # an object is at rest once slower than `settle_speed` for this long


@dataclass(frozen=True)
class Pose:
    """A resting pose with the extents (metres) that determine the scale."""

    rotation: Rotation
    height: float
    top: float
    footprint: float
    radius: float
    probability: float

    @property
    def down(self) -> NDArray:
        """The direction of gravity in the object's frame, [3]."""
        return self.rotation.inv().apply([0.0, 0.0, -1.0])


def find_rests(
    pieces: Sequence[NDArray], cfg: ObjectsConfig, rng: np.random.Generator
) -> list[tuple[Rotation, float]]:
    """Drop a body from random orientations and group the poses in which it comes to rest.

    `pieces` are convex, each [P, 3] in metres, centred on their common centroid.

    Drops still moving after `settle_seconds` are discarded, as are poses rarer than
    `settle_min_probability`. A family of similar poses (a cylinder on its side at any roll angle)
    counts as one for this, because each member alone would be too rare to keep.

    Returns:
        (orientation at yaw zero, probability), most probable first; empty if no drop came to rest.
    """
    model = _drop_model(pieces, cfg)
    points = np.concatenate(pieces)
    drops = [_drop(model, points, Rotation.random(rng=rng), cfg) for _ in range(cfg.settle_drops)]
    settled = [rotation for rotation in drops if rotation is not None]
    return _group(settled, points, cfg.settle_min_probability) if settled else []


def tipping_angle(points: NDArray) -> float:
    """The tilt, in degrees, at which an object falls over; 0 if its support is a line or a point.

    The support is every vertex within 2% of the object's size of the lowest one.

    Args:
        points: [P, 3] collision vertices in the resting orientation, relative to the centre of
            mass.
    """
    bottom = points[:, 2].min()
    support = points[points[:, 2] < bottom + 0.02 * np.ptp(points, axis=0).max(), :2]
    try:
        edges = ConvexHull(support).equations  # outward normals; offset = -distance from origin
    except QhullError:
        return 0.0
    return float(np.degrees(np.arctan2(max(0.0, -edges[:, -1].max()), -bottom)))


def _drop_model(pieces: Sequence[NDArray], cfg: ObjectsConfig) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.option.timestep = TIMESTEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # condim 6 adds rolling friction, without which a can or an apple would never stop.
    surface = {"condim": 6, "friction": list(cfg.settle_friction), "solref": list(SOLREF)}
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], **surface)
    body = spec.worldbody.add_body()
    body.add_freejoint()
    for index, piece in enumerate(pieces):
        spec.add_mesh(name=f"piece{index}", uservert=np.asarray(piece, float).ravel().tolist())
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"piece{index}",
            density=cfg.density,
            **surface,
        )
    return spec.compile()


def _drop(
    model: mujoco.MjModel, points: NDArray, rotation: Rotation, cfg: ObjectsConfig
) -> Rotation | None:
    data = mujoco.MjData(model)
    reach = float(np.linalg.norm(points, axis=1).max())
    data.qpos[2] = 0.003 - rotation.apply(points)[:, 2].min()
    data.qpos[3:] = rotation.as_quat(scalar_first=True)
    still = 0
    for _ in range(round(cfg.settle_seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        speed = np.linalg.norm(data.qvel[:3]) + reach * np.linalg.norm(data.qvel[3:])
        still = still + 1 if speed < cfg.settle_speed else 0
        if still * model.opt.timestep >= STILL_SECONDS:
            return Rotation.from_quat(data.qpos[3:], scalar_first=True)
    return None


def _group(
    settled: list[Rotation], points: NDArray, min_probability: float
) -> list[tuple[Rotation, float]]:
    down = np.array([rotation.inv().apply([0.0, 0.0, -1.0]) for rotation in settled])
    signature = np.array([_signature(rotation, points) for rotation in settled])
    close = np.arccos(np.clip(down @ down.T, -1, 1)) < SAME_FACE
    size = np.linalg.norm(points, axis=1).max()
    alike = np.linalg.norm(signature[:, None] - signature, axis=2) < 0.04 * size
    faces = components(close & alike)
    families = components(alike)
    kept: list[tuple[int, float]] = []
    for family in families:
        share = len(family) / len(settled)
        if share < min_probability:
            continue
        members = sorted((face for face in faces if face[0] in family), key=len, reverse=True)
        common = [face for face in members if len(face) >= min_probability * len(settled)]
        common = common or members[:1]
        counted = sum(len(face) for face in common)
        kept += [(_middle(face, down), share * len(face) / counted) for face in common]
    total = sum(share for _, share in kept)
    kept.sort(key=lambda pair: -pair[1])
    return [(without_yaw(settled[index]), share / total) for index, share in kept]


def _signature(rotation: Rotation, points: NDArray) -> NDArray:
    """[4] lengths (m) that are independent of yaw and, for a round body, of the roll angle."""
    turned = rotation.apply(points)
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(turned[:, :2].T)).clip(0))
    return np.array([-turned[:, 2].min(), turned[:, 2].max(), *spread])


def components(linked: NDArray) -> list[list[int]]:
    """Connected components of a symmetric boolean matrix [n, n], ordered by first member."""
    count, labels = connected_components(linked, directed=False)
    return sorted(np.flatnonzero(labels == label).tolist() for label in range(count))


def _middle(face: list[int], down: NDArray) -> int:
    """The member closest to the mean down direction of the group."""
    mean = down[face].mean(axis=0)
    return face[int(np.argmax(down[face] @ mean))]


def without_yaw(rotation: Rotation) -> Rotation:
    """Rotate an orientation about the vertical to yaw zero.

    At yaw zero the object's x axis (or y axis, if x is upright) points along world x.
    """
    axes = rotation.as_matrix()
    column = 0 if np.hypot(axes[0, 0], axes[1, 0]) > 0.1 else 1
    yaw = np.arctan2(axes[1, column], axes[0, column])
    return Rotation.from_euler("z", -yaw) * rotation


def to_rest(pose: Pose, scale: float) -> Rest:
    """Return the catalogue entry of a pose after uniform scaling."""
    w, x, y, z = (
        float(value) for value in pose.rotation.as_quat(canonical=True, scalar_first=True)
    )
    return Rest((w, x, y, z), pose.height * scale, pose.radius * scale, pose.probability)
