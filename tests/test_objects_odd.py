"""A folder of odd meshes: the good ones load, the bad ones are named, one line each."""

from __future__ import annotations

import dataclasses
import logging
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from configs import real_config
from odd_meshes import BAD, GOOD

from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.objects.mesh_folder import NAME_BYTES, find_meshes, shown
from sdfgcn.objects.model import ObjectModel

pytest.importorskip("trimesh", reason="needs the extra [meshes]")
pytest.importorskip("coacd", reason="needs the extra [meshes]")

NAMES_OF_ROOT = {"unreadable.obj"} if os.geteuid() == 0 else set()  # root reads everything


class Convex:
    """In place of CoACD, which takes seconds a mesh: one piece, the convex hull.

    `tests/test_objects_shapenet.py` uses CoACD itself.
    """

    Mesh = staticmethod(lambda vertices, faces: vertices)

    def set_log_level(self, level: str) -> None: ...

    def run_coacd(self, mesh: np.ndarray, **options: object) -> list:
        return [(mesh, None)]


class Lines(logging.Handler):
    """Keeps the lines of a log."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The folder, with a linked folder beside all odd files."""
    root = tmp_path_factory.mktemp("odd")
    for name, write in [*GOOD.items(), *((name, bad[0]) for name, bad in BAD.items())]:
        write(root / name)
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    GOOD["box.obj"](elsewhere / "inside.obj")
    (root / "linked").symlink_to(elsewhere)
    yield root
    (root / "unreadable.obj").chmod(0o600)


@pytest.fixture(scope="module")
def loaded(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict[str, ObjectModel], list[str]]:
    """The catalogue by name, and the lines of the log; built once for all tests here."""
    config = real_config("objects=shapenet").env.objects
    config = dataclasses.replace(config, root=str(folder), settle_drops=2, settle_speed=0.02)
    handler = Lines()
    logging.getLogger("sdfgcn").addHandler(handler)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "coacd", Convex())
        patch.setenv("SDFGCN_CACHE", str(tmp_path_factory.mktemp("cache")))
        models = {m.name: m for split in ("train", "test") for m in load_catalogue(config, split)}
    logging.getLogger("sdfgcn").removeHandler(handler)
    return models, handler.lines


def test_there_are_sixty() -> None:
    assert len(GOOD) + len(BAD) >= 60


@pytest.mark.parametrize("name", GOOD, ids=ascii)
def test_a_good_mesh_loads(name: str, folder: Path, loaded: tuple) -> None:
    models, lines = loaded
    file = next(file for file in find_meshes(folder) if file.relative == name)
    assert file.name in models, [line for line in lines if shown(Path(name)) in line]
    model = models[file.name]
    assert model.rests and model.mass > 0


@pytest.mark.parametrize("name", BAD, ids=ascii)
def test_a_bad_mesh_is_named_with_the_reason(name: str, folder: Path, loaded: tuple) -> None:
    if name in NAMES_OF_ROOT:
        pytest.skip("root may read every file")
    models, lines = loaded
    assert Path(name).stem not in models
    called = "object holes " if name == "holes.obj" else f"/{shown(Path(name))} "
    about = [line for line in lines if called in line]
    assert len(about) == 1, lines
    assert re.search(BAD[name][1], about[0]), about
    assert about[0].startswith("Left out: ") and "\n" not in about[0]


def test_nothing_else_is_left_out(loaded: tuple) -> None:
    models, lines = loaded
    assert len(lines) == len(BAD) - len(NAMES_OF_ROOT)
    assert "linked_inside" in models  # a linked folder is followed


def test_names_can_be_used_everywhere(loaded: tuple) -> None:
    for name in loaded[0]:
        assert len(name.encode()) <= NAME_BYTES and name.isprintable()
        assert not set(name) & set("/\\;")
