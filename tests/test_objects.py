"""What every catalogue promises, measured on the catalogues themselves."""

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest
from configs import real_config
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from sdfgcn.config import SPLITS, ObjectsConfig
from sdfgcn.objects.catalogue import catalogue_folder, load_catalogue
from sdfgcn.objects.fetch import scans_dir
from sdfgcn.objects.model import ObjectModel
from sdfgcn.registry import OBJECTS

EPS = 1e-5  # metres; vertices are float32
HOLLOW = {  # share of the hull that the pieces of a concave object may fill
    "household": {"bowl_1": 0.5, "mug_1": 0.5, "cup_1": 0.5, "basket_1": 0.5, "tray_1": 0.6},
    "scanned": {"bowl": 0.7, "cup": 0.6, "coffeemug": 0.6, "wineglass": 0.5, "fryingpan": 0.5}
    | {"035_power_drill": 0.6, "train": 0.8, "alarmclock": 0.85},  # those cut into convex pieces
}


# Not a user's own meshes, which have tests of their own.
@pytest.fixture(scope="module", params=sorted(OBJECTS.keys() - {"shapenet"}))
def cfg(request) -> Iterator[ObjectsConfig]:
    cfg = real_config(f"objects={request.param}").env.objects
    if cfg.name == "scanned" and not (scans_dir().is_dir() and catalogue_folder(cfg).is_dir()):
        pytest.skip("the scanned catalogue is not in the cache")
    yield cfg


@pytest.fixture(scope="module")
def models(cfg) -> dict[str, tuple[ObjectModel, ...]]:
    return {split: load_catalogue(cfg, split) for split in SPLITS}


def every(models) -> list[ObjectModel]:
    return [model for split in SPLITS for model in models[split]]


def poses(model) -> Iterator[tuple[Rotation, float, float]]:
    for rest in model.rests:
        yield Rotation.from_quat(rest.quat, scalar_first=True), rest.height, rest.radius


def everything(model) -> np.ndarray:
    return np.concatenate([model.vertices, *model.pieces]).astype(float)


def footprint(points: np.ndarray) -> float:
    flat = points[:, :2]
    return pdist(flat[ConvexHull(flat).vertices]).max()


def is_inside(points: np.ndarray, piece: np.ndarray, margin: float = 0.0) -> np.ndarray:
    equations = ConvexHull(piece).equations
    return (points @ equations[:, :3].T + equations[:, 3]).max(axis=1) <= margin


def test_split_sizes(cfg, models):
    if cfg.name in HOLLOW:  # those that come with the package
        assert {split: len(models[split]) for split in SPLITS} == {"train": 32, "test": 16}
    assert all(models.values())


def test_names_are_unique_and_categories_disjoint(models):
    names = [model.name for model in every(models)]
    assert len(set(names)) == len(names)
    train, test = ({model.category for model in models[split]} for split in SPLITS)
    assert train.isdisjoint(test)


def test_sizes_and_masses_are_within_the_limits(cfg, models):
    for model in every(models):
        assert cfg.mass_min <= model.mass <= cfg.mass_max, model.name
        for index, (rotation, height, _) in enumerate(poses(model)):
            turned = rotation.apply(everything(model))
            across, up = footprint(turned), turned[:, 2].max() + height
            assert across <= cfg.footprint_max + EPS, model.name
            assert cfg.thickness_min - EPS <= up <= cfg.height_max + EPS, model.name
            if index == 0:
                assert across >= cfg.footprint_min - EPS, model.name


def test_rests_match_the_vertices(models):
    for model in every(models):
        shares = [rest.probability for rest in model.rests]
        assert shares == sorted(shares, reverse=True)
        assert sum(shares) == pytest.approx(1.0)
        for rotation, height, radius in poses(model):
            lowest = rotation.apply(np.concatenate(model.pieces).astype(float))[:, 2].min()
            assert height == pytest.approx(-lowest, abs=EPS), model.name
            turned = rotation.apply(everything(model))
            assert radius == pytest.approx(np.linalg.norm(turned[:, :2], axis=1).max(), abs=EPS)
            axes = rotation.as_matrix()[:2]  # yaw zero: x, or y where x is upright, along world x
            column = 0 if np.hypot(*axes[:, 0]) > 0.1 else 1
            assert axes[0, column] > 0 and axes[1, column] == pytest.approx(0.0, abs=1e-6)


def test_meshes_are_sound(cfg, models):
    for model in every(models):
        assert len(model.faces) <= cfg.max_faces, model.name
        assert model.faces.min() >= 0 and model.faces.max() < len(model.vertices), model.name
        a, b, c = (model.vertices[model.faces[:, k]].astype(float) for k in range(3))
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0, f"{model.name} is inside out"
        assert (model.uv is None) == (model.texture is None)
        if model.texture is not None:
            assert model.texture.shape == (cfg.texture_size, cfg.texture_size, 3)
            assert model.uv.shape == (len(model.vertices), 2)
            assert model.uv.min() >= -0.01 and model.uv.max() <= 1.01


def test_pieces_are_convex_and_follow_the_mesh(cfg, models):
    for model in every(models):
        assert 1 <= len(model.pieces) <= cfg.max_pieces, model.name
        outside = np.full(len(model.vertices), np.inf)
        for piece in model.pieces:
            assert len(piece) <= cfg.max_piece_vertices
            hull = ConvexHull(piece)
            assert len(hull.vertices) >= 0.9 * len(piece), model.name  # all but none inside
            reach = model.vertices @ hull.equations[:, :3].T + hull.equations[:, 3]
            outside = np.minimum(outside, reach.max(axis=1))
            assert is_inside(piece, model.vertices, margin=0.005).all(), model.name
        assert outside.max() < 0.006, model.name


def test_origin_is_the_centre_of_mass(models):
    for model in every(models):
        body = compiled(model).body("object")
        assert np.abs(body.ipos).max() < 2e-4, model.name


def test_hollows_stay_open(cfg, models):
    hollow = HOLLOW.get(cfg.name, {})
    rng = np.random.default_rng(0)
    for model in every(models):
        if model.name in hollow:
            points = np.concatenate(model.pieces)
            drawn = rng.uniform(points.min(axis=0), points.max(axis=0), (3000, 3))
            drawn = drawn[is_inside(drawn, points)]
            filled = np.any([is_inside(drawn, piece) for piece in model.pieces], axis=0)
            assert filled.mean() < hollow[model.name], model.name


def test_resting_poses_rest(models):
    for model in every(models):
        simulated = compiled(model)
        for rotation, height, _ in poses(model):
            data = mujoco.MjData(simulated)
            start = np.array([0.0, 0.0, height])
            data.qpos[:3], data.qpos[3:] = start, rotation.as_quat(scalar_first=True)
            mujoco.mj_step(simulated, data, 150)
            assert np.linalg.norm(data.qpos[:3] - start) < 0.002, model.name
            turn = Rotation.from_quat(data.qpos[3:], scalar_first=True) * rotation.inv()
            assert np.rad2deg(turn.magnitude()) < 4.0, model.name


def test_an_object_that_stands_on_its_edge_would_fail_the_test_above():
    household = load_catalogue(real_config("objects=household").env.objects, "train")
    model = next(model for model in household if model.name == "book_1")
    simulated = compiled(model)
    data = mujoco.MjData(simulated)
    edge = Rotation.from_euler("x", 30, degrees=True)
    height = -edge.apply(np.concatenate(model.pieces))[:, 2].min()
    data.qpos[2], data.qpos[3:] = height, edge.as_quat(scalar_first=True)
    mujoco.mj_step(simulated, data, 150)
    assert abs(data.qpos[2] - height) > 0.002


def compiled(model: ObjectModel) -> mujoco.MjModel:
    """The object's pieces over a plane, with the env's kind of contact."""
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    surface = {"condim": 6, "friction": [0.3, 0.005, 0.002], "solref": [0.005, 1.0]}
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], **surface)
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint()
    for number, piece in enumerate(model.pieces):
        spec.add_mesh(name=f"piece{number}", uservert=piece.astype(float).ravel().tolist())
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"piece{number}", **surface)
    return spec.compile()
