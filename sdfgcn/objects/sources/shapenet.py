"""Meshes from a user's directory: ShapeNetCore, ShapeNetSem, or any folder of OBJ, GLB or STL.

The layout is recognised from each file's path relative to `env.objects.root`:

* `<synset>/<id>/models/model_normalized.obj` (ShapeNetCore): category = synset, or its name if
  the root contains `taxonomy.json`.
* `models/<id>.obj` or a plain folder (ShapeNetSem): category from `metadata.csv` if present,
  otherwise each mesh is its own category.
* `<category>/.../<name>.obj`: category = first folder.

An object is called after its category and its path below it, `mug_0a1b` or `cup_model`.
"""

from __future__ import annotations

import importlib
import logging
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType

from omegaconf import OmegaConf
from yaml import YAMLError

from sdfgcn.config import SPLITS, ObjectsConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.mesh_file import read_mesh
from sdfgcn.objects.mesh_folder import SUFFIXES, MeshFile, digest, scan
from sdfgcn.objects.model import Recipe, Source
from sdfgcn.registry import OBJECTS

READING = 2  # increment whenever the same files would yield different objects
TEST_SHARE = 1 / 3  # of the categories, without a split file

log = logging.getLogger(__name__)


@dataclass
class ShapenetConfig(ObjectsConfig):
    """Settings of `conf/objects/shapenet.yaml`.

    Attributes:
        root: The directory of meshes.
        split_file: YAML file with the lists train and test; None to split by category or name.
    """

    root: str | None = None
    split_file: str | None = None


def recipes(cfg: ShapenetConfig) -> list[Recipe]:
    """Return a recipe for every mesh that belongs to a split; log what cannot be reached.

    Raises:
        SdfgcnError: The extra [meshes] is not installed, the directory is missing or contains no
            mesh, or the split file is invalid.
    """
    trimesh, coacd = _library("trimesh"), _library("coacd")
    coacd.set_log_level("error")
    files, problems = scan(_root(cfg))
    for problem in problems:
        log.warning("Left out: %s", problem)
    splits = _listed(files, cfg.split_file) if cfg.split_file else divided(files)
    return [
        Recipe(file.name, file.category, split, partial(read_mesh, file, cfg, trimesh, coacd))
        for file, split in zip(files, splits, strict=True)
        if split is not None
    ]


def fingerprint(cfg: ShapenetConfig) -> str:
    """Return text that changes with the root, its mesh files and the split file."""
    files, problems = scan(_root(cfg))
    lines = [str(READING), str(_root(cfg).resolve()), *problems]
    for file in files:
        about = file.path.stat()
        lines.append(f"{file.relative} {about.st_size} {about.st_mtime_ns}")
    if cfg.split_file:
        lines.append(_split_text(cfg.split_file))
    return digest("\n".join(lines))


OBJECTS.register("shapenet", config=ShapenetConfig)(Source(recipes, fingerprint, lenient=True))


def divided(files: list[MeshFile]) -> list[str]:
    """Assign splits without a split file: a third of the categories is held out for testing.

    The third is chosen by the hashes of the category names. If there is only one category, its
    meshes are split the same way by their own names.
    """
    one_category = len({file.category for file in files}) == 1
    keys = [file.name if one_category else file.category for file in files]
    order = sorted(set(keys), key=digest)
    held_out = set(order[: max(1, round(len(order) * TEST_SHARE))])
    return ["test" if key in held_out else "train" for key in keys]


def _root(cfg: ShapenetConfig) -> Path:
    if cfg.root is None:
        raise SdfgcnError(
            "objects=shapenet needs a directory of meshes: give it as env.objects.root=PATH."
        )
    root = Path(cfg.root).expanduser()
    if not root.is_dir():
        raise SdfgcnError(
            f"env.objects.root is {root}, but there is no such directory; give one with meshes "
            f"({', '.join(SUFFIXES)})."
        )
    return root


def _library(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise SdfgcnError(
            f"objects=shapenet needs {name}, which is not installed; "
            "`pip install -e '.[meshes]'` does that."
        ) from error


def _split_text(split_file: str) -> str:
    try:
        return Path(split_file).expanduser().read_text(encoding="utf-8")
    except OSError as error:
        raise SdfgcnError(
            f"env.objects.split_file is {split_file}, but it cannot be read ({error.strerror}); "
            "give a YAML file with the lists train and test."
        ) from error


def _listed(files: list[MeshFile], split_file: str) -> list[str | None]:
    """Assign splits by a YAML file that lists names, relative paths or categories per split.

    Returns:
        One split per file, None for unlisted files.
    """
    try:
        lists = OmegaConf.to_container(OmegaConf.create(_split_text(split_file)))
    except YAMLError as error:
        raise SdfgcnError(
            f"{split_file} cannot be read as YAML ({getattr(error, 'problem', error)})."
        ) from error
    if not isinstance(lists, dict) or not all(isinstance(lists.get(key), list) for key in SPLITS):
        raise SdfgcnError(f"{split_file} must hold two lists, train and test, of names or paths.")
    splits: list[str | None] = [None] * len(files)
    for split in SPLITS:
        for entry in map(str, lists[split]):
            found = [k for k, file in enumerate(files) if entry in _handles(file)]
            if not found:
                raise SdfgcnError(
                    f"{split_file} lists {entry!r} under {split}, but no mesh below "
                    "env.objects.root has this name, path or category."
                )
            for k in found:
                if splits[k] not in (None, split):
                    raise SdfgcnError(
                        f"{split_file} lists {files[k].relative} under train and under test; "
                        "take it out of one."
                    )
                splits[k] = split
    return splits


def _handles(file: MeshFile) -> Iterable[str]:
    path = file.relative
    return (file.name, file.id, path, path.rpartition(".")[0], file.category)
