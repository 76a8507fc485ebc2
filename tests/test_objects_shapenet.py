"""A user's directory of meshes, written here and read back as a catalogue."""

import dataclasses
import logging
import sys

import numpy as np
import pytest
from configs import real_config

from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.catalogue import catalogue_folder, load_catalogue
from sdfgcn.objects.mesh_folder import find_meshes
from sdfgcn.objects.sources.shapenet import divided


@pytest.fixture(scope="module")
def base():
    return real_config("objects=shapenet").env.objects


@pytest.fixture
def cfg(base, tmp_path, monkeypatch):
    monkeypatch.setenv("SDFGCN_CACHE", str(tmp_path / "cache"))
    (tmp_path / "meshes").mkdir()
    return dataclasses.replace(base, root=str(tmp_path / "meshes"), settle_drops=8)


@pytest.fixture
def trimesh():
    pytest.importorskip("coacd", reason="needs the extra [meshes]")
    return pytest.importorskip("trimesh", reason="needs the extra [meshes]")


@pytest.fixture
def meshes(cfg, tmp_path, trimesh):
    """Three layouts and one broken file."""
    from PIL import Image

    root = tmp_path / "meshes"

    def save(mesh, path):
        (root / path).parent.mkdir(parents=True, exist_ok=True)
        mesh.export(root / path)

    save(trimesh.creation.cylinder(0.3, 1.0), "02876657/abc/models/model_normalized.obj")
    save(trimesh.creation.annulus(0.5, 1.0, 0.5), "rings/ring.stl")
    cube = trimesh.creation.box((1.0, 1.0, 0.5))
    cube.visual = trimesh.visual.TextureVisuals(
        uv=np.tile([[0.25, 0.1]], (len(cube.vertices), 1)), image=Image.new("RGB", (8, 8), "red")
    )
    save(cube, "cubes/cube.glb")
    (root / "broken.obj").write_text("no mesh")
    return root


def paths(root, *names):
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("")
    return {file.relative: (file.name, file.category) for file in find_meshes(root)}


def test_layouts(tmp_path):
    (tmp_path / "taxonomy.json").write_text('[{"synsetId": "02876657", "name": "bottle,flask"}]')
    (tmp_path / "metadata.csv").write_text('fullId,category\nwss.f00,"Mug,Cup"\n')
    assert paths(
        tmp_path,
        "02876657/abc/models/model_normalized.obj",
        "models/f00.obj",
        "toys/x.STL",
        "y.glb",
    ) == {
        "02876657/abc/models/model_normalized.obj": ("bottle_abc", "bottle"),
        "models/f00.obj": ("Mug_f00", "Mug"),
        "toys/x.STL": ("toys_x", "toys"),
        "y.glb": ("y", "y"),
    }


def test_same_name_twice_stays_apart(tmp_path):
    names = [name for name, _ in paths(tmp_path, "a/x.obj", "b/x.obj").values()]
    assert len(set(names)) == 2


def test_default_split_keeps_categories_apart(tmp_path):
    paths(tmp_path, *[f"c{k}/{name}.obj" for k in range(9) for name in "ab"])
    files = find_meshes(tmp_path)
    splits = divided(files)
    train = {f.category for f, split in zip(files, splits, strict=True) if split == "train"}
    test = {f.category for f, split in zip(files, splits, strict=True) if split == "test"}
    assert len(test) == 3 and len(train) == 6 and train.isdisjoint(test)
    assert divided(files) == splits


def test_catalogue_of_three_formats(cfg, meshes, caplog):
    with caplog.at_level(logging.WARNING):
        models = {m.name: m for split in ("train", "test") for m in load_catalogue(cfg, split)}
    assert set(models) == {"02876657_abc", "rings_ring", "cubes_cube"}
    assert "broken.obj" in caplog.text
    assert len(models["rings_ring"].pieces) > 3  # the hole stays open
    cube = models["cubes_cube"]
    assert cube.texture is not None and cube.texture[0, 0].tolist() == [255, 0, 0]
    assert cube.uv is not None
    np.testing.assert_allclose(cube.uv[0], [0.25, 0.9], atol=1e-5)  # v turned over
    for model in models.values():
        assert cfg.mass_min <= model.mass <= cfg.mass_max
        assert 0.5 * cfg.footprint_min <= model.rests[0].radius <= cfg.footprint_max


def test_split_file(cfg, meshes, tmp_path):
    split = tmp_path / "split.yaml"
    split.write_text("train: [rings]\ntest: [cubes/cube.glb]\n")
    listed = dataclasses.replace(cfg, split_file=str(split))
    assert [m.name for m in load_catalogue(listed, "train")] == ["rings_ring"]
    assert [m.name for m in load_catalogue(listed, "test")] == ["cubes_cube"]
    assert catalogue_folder(listed) != catalogue_folder(cfg)
    split.write_text("train: [rings]\ntest: [nothing]\n")
    with pytest.raises(SdfgcnError, match="'nothing' under test"):
        load_catalogue(listed, "train")
    split.write_text("train: [rings]\ntest: [ring]\n")
    with pytest.raises(SdfgcnError, match="under train and under test"):
        load_catalogue(listed, "train")
    split.write_text("train: [rings")
    with pytest.raises(SdfgcnError, match="cannot be read"):
        load_catalogue(listed, "train")


def test_missing_directory_and_empty_directory(cfg, tmp_path):
    with pytest.raises(SdfgcnError, match=r"give it as env\.objects\.root"):
        load_catalogue(dataclasses.replace(cfg, root=None), "train")
    with pytest.raises(SdfgcnError, match="no such directory"):
        load_catalogue(dataclasses.replace(cfg, root=str(tmp_path / "none")), "train")
    with pytest.raises(SdfgcnError, match="there is no mesh"):
        load_catalogue(cfg, "train")


def test_missing_extra_is_named(cfg, tmp_path, monkeypatch):
    (tmp_path / "meshes" / "a.obj").write_text("")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(SdfgcnError, match=r"pip install -e '\.\[meshes\]'"):
        load_catalogue(cfg, "train")
