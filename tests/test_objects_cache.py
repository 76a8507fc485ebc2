"""Building, caching and what is said when either fails."""

import dataclasses
import hashlib
import json
import shutil
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
from sdfgcn.objects.prepare import prepare
from sdfgcn.objects.sources import household
from sdfgcn.objects.storage import MANIFEST, new_folder, read_models, write_models
from sdfgcn.registry import OBJECTS


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


# ------------------------------------------------------------------ what is read

ENTRIES = {
    "mass in words": (lambda entry: entry.update(mass="heavy"), "mass of book_1 is 'heavy'"),
    "no mass": (lambda entry: entry.update(mass=0.0), r"mass of book_1 is 0\.0"),
    "mass of nan": (lambda entry: entry.update(mass=float("nan")), "mass of book_1 is nan"),
    "no rests": (lambda entry: entry.update(rests=[]), r"resting poses of book_1 are \[\]"),
    "a rest of nan": (lambda entry: entry["rests"][0].__setitem__(1, float("nan")), "resting"),
    "a short rest": (lambda entry: entry["rests"][0].pop(), "resting poses of book_1"),
    "no unit": (lambda entry: entry["rests"][0].__setitem__(0, [1, 1, 0, 0]), "resting poses"),
    "unlikely": (lambda entry: entry["rests"][0].__setitem__(3, 0.01), "do not sum to 1"),
    "no split": (lambda entry: entry.update(split="all"), "split of book_1 is 'all'"),
    "other keys": (lambda entry: entry.update(code="x"), "other keys"),
    "no text": (lambda entry: entry.update(category=3), "must be a text"),
    "elsewhere": (lambda entry: entry.update(file="../book_1.npz"), "has the file"),
}


def rewritten(folder, change, entries_checksum=True):
    """Change the first entry of a manifest; with the checksum of the new entries, or the old."""
    manifest = json.loads((folder / MANIFEST).read_text())
    change(manifest["objects"][0])
    if entries_checksum:
        content = json.dumps(manifest["objects"], sort_keys=True).encode()
        manifest["sha256"] = hashlib.sha256(content).hexdigest()
    (folder / MANIFEST).write_text(json.dumps(manifest))


def refused(folder, told):
    with pytest.raises(SdfgcnError, match=told) as raised:
        read_models(folder, "train")
    assert "is damaged (" in str(raised.value) and "\n" not in str(raised.value)
    assert str(raised.value).endswith(f"delete the folder {folder} and run again to rebuild it.")


@pytest.fixture(scope="module")
def book(tmp_path_factory, base):
    """The first household object, as a cache."""
    recipe = next(each for each in OBJECTS.find("household").recipes(base) if each.name == "book_1")
    folder = tmp_path_factory.mktemp("book") / "cache"
    write_models(folder, [prepare(recipe, dataclasses.replace(base, settle_drops=6))])
    return folder


@pytest.fixture
def folder(book, tmp_path):
    return shutil.copytree(book, tmp_path / "copy")


@pytest.mark.parametrize("case", ENTRIES)
def test_an_entry_of_another_kind_is_refused(case, folder):
    change, told = ENTRIES[case]
    rewritten(folder, change)
    refused(folder, told)


def test_an_altered_manifest_is_noticed(folder):
    rewritten(folder, lambda entry: entry.update(mass=entry["mass"] * 2), entries_checksum=False)
    refused(folder, "its checksum does not match its entries")


def test_a_manifest_of_before_there_was_a_checksum(folder):
    manifest = json.loads((folder / MANIFEST).read_text())
    (folder / MANIFEST).write_text(json.dumps({"objects": manifest["objects"]}))
    assert [model.name for model in read_models(folder, "train")] == ["book_1"]


@pytest.mark.parametrize("content", ["[]", "3", '{"objects": {}, "more": 1}', "[" * 10**5])
def test_another_manifest_is_refused(content, folder):
    (folder / MANIFEST).write_text(content)
    refused(folder, "manifest")


def test_flipped_bits_are_noticed(folder):
    file = folder / "book_1.npz"
    content = file.read_bytes()
    for place in range(0, len(content), len(content) // 7):
        flipped = bytearray(content)
        flipped[place] ^= 1
        file.write_bytes(flipped)
        refused(folder, "its checksum does not match the manifest")


def nan_vertices(arrays):
    arrays["vertices"][0, 0] = np.nan


def huge_points(arrays):
    arrays["points"][0, 0] = np.inf


def code(arrays):
    arrays["faces"] = np.array([print], dtype=object)


ARRAYS = {
    "nan vertices": (nan_vertices, "its vertices are not finite"),
    "inf points": (huge_points, "its points are not finite"),
    "flat": (lambda arrays: arrays.update(vertices=np.zeros((4, 2))), r"are float64 \[4, 2\]"),
    "empty": (lambda arrays: arrays.update(vertices=np.zeros((0, 3))), r"float64 \[0, 3\]"),
    "faces of floats": (lambda arrays: arrays.update(faces=np.ones((2, 3))), "its faces are float"),
    "faces of nothing": (lambda arrays: arrays["faces"].fill(10**6), "vertices that there are not"),
    "pieces": (lambda arrays: arrays["ends"].__iadd__(1), "other points than there are"),
    "texture": (lambda arrays: arrays.update(texture=np.ones((2, 2, 3))), "its texture are"),
    "uv": (lambda arrays: arrays.update(uv=np.ones((2, 2))), "its uv are"),
    "more": (lambda arrays: arrays.update(more=np.ones(1)), "its arrays are"),
    "a pickle": (code, "allow_pickle=False"),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_arrays_of_another_kind_are_refused(case, folder):
    """Also where somebody has made the checksums anew."""
    change, told = ARRAYS[case]
    file = folder / "book_1.npz"
    with np.load(file) as stored:
        arrays = {name: stored[name].copy() for name in stored.files}
    change(arrays)
    np.savez(file, **arrays)
    checksum = hashlib.sha256(file.read_bytes()).hexdigest()
    rewritten(folder, lambda entry: entry.update(sha256=checksum))
    refused(folder, told)


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
