"""Building, caching and what is said when either fails."""

import dataclasses
import subprocess
import threading
import zipfile

import numpy as np
import pytest
from configs import real_config

from sdfgcn.errors import SdfgcnError
from sdfgcn.objects import catalogue, fetch
from sdfgcn.objects.catalogue import catalogue_folder, load_catalogue
from sdfgcn.objects.contact_sheet import main
from sdfgcn.objects.sources import household
from sdfgcn.objects.storage import MANIFEST, new_folder


@pytest.fixture(scope="module")
def base():
    return real_config("objects=household").env.objects


@pytest.fixture
def cfg(base, tmp_path, monkeypatch):
    """Three household objects and few drops, in a cache of their own."""
    monkeypatch.setenv("SDFGCN_CACHE", str(tmp_path / "cache"))
    for table, categories in (("TRAIN", ("book", "ring")), ("TEST", ("car",))):
        kept = {name: getattr(household, table)[name] for name in categories}
        first = {name: (draw, variants[:1]) for name, (draw, variants) in kept.items()}
        monkeypatch.setattr(household, table, first)
    return dataclasses.replace(base, settle_drops=6)


def equal(one, other) -> bool:
    return (one.name, one.mass, one.rests) == (other.name, other.mass, other.rests) and all(
        np.array_equal(a, b)
        for a, b in zip(
            (one.vertices, one.faces, *one.pieces),
            (other.vertices, other.faces, *other.pieces),
            strict=True,
        )
    )


def test_two_builds_agree_and_a_second_load_reads_the_cache(cfg, tmp_path, monkeypatch):
    first = load_catalogue(cfg, "train")
    assert [model.name for model in first] == ["book_1", "ring_1"]
    assert [model.name for model in load_catalogue(cfg, "test")] == ["car_1"]
    with monkeypatch.context() as patch:
        patch.setattr(catalogue, "prepare", lambda *_: pytest.fail("built again"))
        again = load_catalogue(cfg, "train")
    monkeypatch.setenv("SDFGCN_CACHE", str(tmp_path / "other"))
    other = load_catalogue(cfg, "train")
    assert all(map(equal, first, again)) and all(map(equal, first, other))


def test_key_depends_on_what_matters(cfg):
    folder = catalogue_folder(cfg)
    assert catalogue_folder(dataclasses.replace(cfg, palette=[[0, 0, 0]])) == folder
    assert catalogue_folder(dataclasses.replace(cfg, height_max=0.09)) != folder


@pytest.mark.parametrize("file", ["book_1.npz", MANIFEST])
def test_truncated_cache_is_named(cfg, file):
    load_catalogue(cfg, "train")
    path = catalogue_folder(cfg) / file
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(SdfgcnError, match="damaged") as raised:
        load_catalogue(cfg, "train")
    assert str(path) in str(raised.value) and "delete the folder" in str(raised.value)


def test_missing_file_is_named(cfg):
    load_catalogue(cfg, "train")
    (catalogue_folder(cfg) / "ring_1.npz").unlink()
    with pytest.raises(SdfgcnError, match=r"ring_1\.npz is damaged"):
        load_catalogue(cfg, "train")


def test_failed_build_leaves_nothing(cfg, monkeypatch):
    def fail(recipe, cfg):
        raise KeyboardInterrupt

    monkeypatch.setattr(catalogue, "prepare", fail)
    with pytest.raises(KeyboardInterrupt):
        load_catalogue(cfg, "train")
    parent = catalogue_folder(cfg).parent
    assert not parent.exists() or not list(parent.iterdir())


def test_interrupted_write_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), new_folder(tmp_path / "target") as scratch:
        (scratch / "half").write_text("x")
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_two_writers_at_once_give_one_whole_folder(tmp_path):
    meet = threading.Barrier(2)

    def write(text: str) -> None:
        with new_folder(tmp_path / "target") as scratch:
            (scratch / "file").write_text(text)
            meet.wait()

    threads = [threading.Thread(target=write, args=(text,)) for text in ("one", "two")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [path.name for path in tmp_path.iterdir()] == ["target"]
    assert (tmp_path / "target" / "file").read_text() in ("one", "two")


def test_unwritable_cache_is_one_sentence(cfg, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SDFGCN_CACHE", str(tmp_path / "file"))
    with pytest.raises(SdfgcnError, match="set SDFGCN_CACHE"):
        load_catalogue(cfg, "train")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "nonsense"}, "must be one of"),
        ({"footprint_min": 0.2}, "footprint_min is 0.2"),
        ({"settle_drops": 0}, "settle_drops is 0"),
        ({"settle_friction": [0.3]}, "must be 3 numbers between 0 and 10"),
        ({"palette": [[1.0, 2.0, 0.0]]}, "palette"),
    ],
)
def test_wrong_settings_are_named(cfg, change, words):
    with pytest.raises(SdfgcnError, match=words):
        load_catalogue(dataclasses.replace(cfg, **change), "train")


def test_wrong_split_is_named(cfg):
    with pytest.raises(SdfgcnError, match="must be one of train, test"):
        load_catalogue(cfg, "validation")


def test_offline_names_the_way_out(tmp_path, monkeypatch):
    monkeypatch.setenv("SDFGCN_CACHE", str(tmp_path))
    failed = subprocess.CompletedProcess([], 1, stderr="noise\nERROR: No matching distribution")
    monkeypatch.setattr(fetch.subprocess, "run", lambda *_, **__: failed)
    with pytest.raises(SdfgcnError) as raised:
        load_catalogue(real_config("objects=scanned").env.objects, "test")
    assert "objects=household" in str(raised.value)
    assert "No matching distribution" in str(raised.value)
    assert not any(tmp_path.rglob("*.stl")) and not fetch.scans_dir().exists()


def test_foreign_wheel_is_refused(tmp_path):
    wheel = tmp_path / fetch.WHEEL
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("anything", "else")
    with pytest.raises(SdfgcnError, match="sha256"):
        fetch.check_wheel(wheel)


def test_fetch_unpacks_only_the_two_folders(tmp_path, monkeypatch):
    monkeypatch.setenv("SDFGCN_CACHE", str(tmp_path / "cache"))

    def download(folder):
        wheel = folder / fetch.WHEEL
        with zipfile.ZipFile(wheel, "w") as archive:
            for name in ("object_sim/LICENSE", "YCB_sim/meshes/a.msh", "robot/b.xml"):
                archive.writestr(f"myosuite/simhive/{name}", name)
        return wheel

    monkeypatch.setattr(fetch, "download_wheel", download)
    monkeypatch.setattr(fetch, "check_wheel", lambda wheel: None)
    folder = fetch.fetch()
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert files == {"object_sim/LICENSE", "YCB_sim/meshes/a.msh"}


def test_contact_sheet_is_written(cfg, tmp_path, capsys):
    from PIL import Image

    out = tmp_path / "sheet.png"
    assert main(["objects=household", "env.objects.settle_drops=6", f"out={out}"]) == 0
    with Image.open(out) as image:
        pixels = np.asarray(image)
    tile = pixels[60:160, 40:160].reshape(-1, 3)
    assert len(np.unique(tile // 32, axis=0)) > 3  # an object stands there, not only the floor
    assert main(["objects=nonsense", f"out={out}"]) == 1
    assert len(capsys.readouterr().err.strip().splitlines()[-1:]) == 1
