"""Meshes from a user's directory: ShapeNetCore, ShapeNetSem, or any folder of OBJ, GLB or STL.

The layout is recognised from each file's path relative to `env.objects.root`:

* `<synset>/<id>/models/model_normalized.obj` (ShapeNetCore): category = synset, or its name if
  the root contains `taxonomy.json`.
* `models/<id>.obj` or a plain folder (ShapeNetSem): category from `metadata.csv` if present,
  otherwise each mesh is its own category.
* `<category>/.../<name>.obj`: category = first folder.
"""

from __future__ import annotations

import csv
import hashlib
import importlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from omegaconf import OmegaConf
from PIL import Image
from scipy.spatial import ConvexHull, QhullError
from yaml import YAMLError

from sdfgcn.config import SPLITS, ObjectsConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.model import Recipe, Shape, Source, name_generator
from sdfgcn.objects.storage import cache_dir, new_folder
from sdfgcn.registry import OBJECTS

SUFFIXES = (".obj", ".glb", ".stl")
TEST_SHARE = 1 / 3  # of the categories, without a split file


@dataclass
class ShapenetConfig(ObjectsConfig):
    """Settings of `conf/objects/shapenet.yaml`.

    Attributes:
        root: The directory of meshes.
        split_file: YAML file with the lists train and test; None to split by category or name.
    """

    root: str | None = None
    split_file: str | None = None


@dataclass(frozen=True)
class MeshFile:
    """One mesh below the root: its path, name and category."""

    path: Path
    relative: str
    name: str
    category: str


def recipes(cfg: ShapenetConfig) -> list[Recipe]:
    """Return a recipe for every mesh that belongs to a split.

    Raises:
        SdfgcnError: The extra [meshes] is not installed, the directory is missing or contains no
            mesh, or the split file is invalid.
    """
    trimesh, coacd = _library("trimesh"), _library("coacd")
    coacd.set_log_level("error")
    files = find_meshes(_root(cfg))
    splits = _listed(files, cfg.split_file) if cfg.split_file else divided(files)
    return [
        Recipe(file.name, file.category, split, partial(_read, file, cfg, trimesh, coacd))
        for file, split in zip(files, splits, strict=True)
        if split is not None
    ]


def fingerprint(cfg: ShapenetConfig) -> str:
    """Return text that changes with the root, its mesh files and the split file."""
    stats = [(file.relative, file.path.stat()) for file in find_meshes(_root(cfg))]
    lines = [str(_root(cfg).resolve())]
    lines += [f"{relative} {stat.st_size} {stat.st_mtime_ns}" for relative, stat in stats]
    if cfg.split_file:
        lines.append(_split_text(cfg.split_file))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


OBJECTS.register("shapenet", config=ShapenetConfig)(Source(recipes, fingerprint, lenient=True))


def find_meshes(root: Path) -> list[MeshFile]:
    """List the meshes below `root`, sorted by path.

    Raises:
        SdfgcnError: There are none.
    """
    paths = sorted(path for path in root.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise SdfgcnError(
            f"env.objects.root is {root}, but there is no mesh ({', '.join(SUFFIXES)}) below it."
        )
    names = _category_names(root)
    files: list[MeshFile] = []
    taken: set[str] = set()
    for path in paths:
        relative = path.relative_to(root).as_posix()
        name, category = _called(path.relative_to(root))
        unique = name if name not in taken else f"{name}-{_digest(relative)[:6]}"
        taken.add(unique)
        files.append(MeshFile(path, relative, unique, names.get(category, category)))
    return files


def divided(files: list[MeshFile]) -> list[str]:
    """Assign splits without a split file: a third of the categories is held out for testing.

    The third is chosen by the hashes of the category names. If there is only one category, its
    meshes are split the same way by their own names.
    """
    one_category = len({file.category for file in files}) == 1
    keys = [file.name if one_category else file.category for file in files]
    order = sorted(set(keys), key=_digest)
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


def _called(relative: Path) -> tuple[str, str]:
    """Name and category of a mesh from its path below the root."""
    folders, stem = relative.parts[:-1], relative.stem
    if len(folders) >= 3 and folders[-1] == "models":  # ShapeNetCore
        return folders[-2], folders[-3]
    if not folders or folders == ("models",):
        return stem, stem
    return "_".join([*folders[1:], stem]), folders[0]


def _category_names(root: Path) -> dict[str, str]:
    """Readable categories by synset (ShapeNetCore) or by model id (ShapeNetSem)."""
    names: dict[str, str] = {}
    taxonomy = root / "taxonomy.json"
    if taxonomy.is_file():
        entries = json.loads(taxonomy.read_text(encoding="utf-8"))
        names |= {entry["synsetId"]: entry["name"].split(",")[0] for entry in entries}
    for metadata in (root / "metadata.csv", root.parent / "metadata.csv"):
        if metadata.is_file():
            with metadata.open(newline="", encoding="utf-8") as table:
                for row in csv.DictReader(table):
                    first = (row.get("category") or "").split(",")[0]
                    if row.get("fullId") and first:
                        names[row["fullId"].removeprefix("wss.")] = first
    return names


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
    return (file.name, file.relative, file.relative.rpartition(".")[0], file.category)


def _read(file: MeshFile, cfg: ObjectsConfig, trimesh: ModuleType, coacd: ModuleType) -> Shape:
    """Read and decompose one mesh.

    Raises:
        SdfgcnError: The mesh cannot be read or is flat.
    """
    try:
        mesh = trimesh.load_scene(file.path).to_mesh()
        vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)
        if len(faces) == 0 or not np.isfinite(vertices).all():
            raise ValueError("it has no faces, or vertices that are not finite")
        ConvexHull(vertices)  # raises for a flat mesh
        uv, texture = _texture(mesh, cfg.texture_size)
        pieces = _decomposed(vertices, faces, cfg.max_pieces, coacd)
    except Exception as error:  # trimesh's readers raise many kinds of errors
        reason = "it is flat" if isinstance(error, QhullError) else str(error).splitlines()[:1]
        reason = reason if isinstance(reason, str) else "".join(reason) or type(error).__name__
        raise SdfgcnError(f"The mesh {file.path} cannot be used ({reason}).") from error
    # ShapeNet's meshes have no unit, so the size is drawn from the allowed range, seeded by name.
    footprint = name_generator(file.name).uniform(cfg.footprint_min, cfg.footprint_max)
    return Shape(vertices, faces, pieces, uv, texture, footprint)


def _texture(mesh: Any, size: int) -> tuple[NDArray | None, NDArray[np.uint8] | None]:
    """The mesh's uv (with v flipped, see `ObjectModel`) and texture, or (None, None)."""
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    uv = getattr(mesh.visual, "uv", None)
    if image is None or uv is None or len(uv) != len(mesh.vertices):
        return None, None
    pixels = image.convert("RGB").resize((size, size), Image.Resampling.BOX)
    return np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]), np.asarray(pixels)


def _decomposed(
    vertices: NDArray, faces: NDArray, max_pieces: int, coacd: ModuleType
) -> tuple[NDArray, ...]:
    """Convex pieces by CoACD, which takes seconds to minutes; cached by the mesh's content."""
    content = vertices.tobytes() + faces.tobytes() + str(max_pieces).encode()
    folder = cache_dir() / "decompositions" / hashlib.sha256(content).hexdigest()[:32]
    if not folder.is_dir():
        parts = coacd.run_coacd(
            coacd.Mesh(vertices, faces),
            threshold=0.08,  # allowed concavity; lower values give more, smaller pieces
            max_convex_hull=max_pieces,
            preprocess_resolution=30,
            mcts_iterations=60,
            seed=0,
        )
        with new_folder(folder) as scratch:
            np.savez(scratch / "pieces.npz", *[np.asarray(points) for points, _ in parts])
    try:
        with np.load(folder / "pieces.npz", allow_pickle=False) as stored:
            pieces = tuple(stored[key] for key in stored.files)
        if not (pieces and all(piece.shape == (len(piece), 3) for piece in pieces)):
            raise ValueError("not points")
        if not all(np.isfinite(piece).all() for piece in pieces):
            raise ValueError("not finite")
        return pieces
    except Exception as error:
        raise ValueError(
            f"its cached pieces in {folder} are damaged; delete that folder"
        ) from error


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
