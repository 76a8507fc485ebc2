"""The mesh files below a user's directory: where they are, what they are called, what is amiss."""

from __future__ import annotations

import csv
import errno
import hashlib
import json
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sdfgcn.errors import SdfgcnError

SUFFIXES = (".obj", ".glb", ".stl")
NAME_BYTES = 160  # longer names are cut; a file name may hold 255 bytes, also with a suffix


@dataclass(frozen=True)
class MeshFile:
    """One mesh below the root.

    Attributes:
        path: Where it is.
        relative: Its path below the root, with forward slashes.
        name: Unique in the catalogue; begins with the category.
        category: See `sdfgcn.objects.sources.shapenet`.
        id: What it is called within its category.
    """

    path: Path
    relative: str
    name: str
    category: str
    id: str


def find_meshes(root: Path) -> list[MeshFile]:
    """List the meshes below `root`, sorted by path; linked folders are followed.

    Raises:
        SdfgcnError: There are none, or a file that names their categories is damaged.
    """
    return scan(root)[0]


def scan(root: Path) -> tuple[list[MeshFile], list[str]]:
    """List the meshes below `root`, and what cannot be read.

    Returns:
        The meshes, as from `find_meshes`, and a sentence for each link that leads nowhere, folder
        that cannot be listed and the like.

    Raises:
        SdfgcnError: See `find_meshes`.
    """
    problems: list[str] = []
    paths = sorted(_walk(root, problems))
    if not paths:
        raise SdfgcnError(
            f"env.objects.root is {root}, but there is no mesh ({', '.join(SUFFIXES)}) below it."
            + "".join(f" {problem}" for problem in problems)
        )
    names = _category_names(root)
    files: list[MeshFile] = []
    taken: set[str] = set()
    for path in paths:
        relative = path.relative_to(root).as_posix()
        ident, folder = _called(path.relative_to(root))
        category = _plain(names.get(folder, folder))
        name = _name(category, ident)
        unique = name if name not in taken else f"{name}-{digest(relative)[:6]}"
        taken.add(unique)
        files.append(MeshFile(path, relative, unique, category, ident))
    return files, problems


def shown(path: Path) -> str:
    """The path as text that can be printed, whatever its bytes."""
    return os.fsencode(path).decode("utf-8", "replace")


def digest(text: str) -> str:
    """A hash of text, which may come from a file name that is no valid UTF-8."""
    return hashlib.sha256(text.encode("utf-8", "surrogateescape")).hexdigest()


def _walk(root: Path, problems: list[str]) -> Iterator[Path]:
    """Every mesh file below `root`; what cannot be read is added to `problems`."""

    def unlisted(error: OSError) -> None:
        problems.append(
            f"The folder {shown(Path(error.filename))} cannot be listed ({error.strerror}); give "
            "yourself the permission to read it."
        )

    for name, folders, files in os.walk(root, onerror=unlisted, followlinks=True):
        folder = Path(name)
        inside = folder.resolve()
        above = {inside, *inside.parents}
        for each in sorted(folders):
            path = folder / each
            if path.is_symlink() and path.resolve() in above:
                folders.remove(each)
                problems.append(
                    f"The link {shown(path)} leads back to a folder that it is in; remove it."
                )
        for each in sorted(files):
            problem = _problem(folder / each)
            if problem is not None:
                problems.append(problem)
            elif Path(each).suffix.lower() in SUFFIXES:
                yield folder / each


def _problem(path: Path) -> str | None:
    """Why a path is no file that can be opened, in a sentence; None if it is one, or no mesh."""
    is_mesh = path.suffix.lower() in SUFFIXES
    try:
        mode = path.stat().st_mode
    except OSError as error:
        if path.is_symlink() and error.errno == errno.ELOOP:
            return f"The link {shown(path)} leads back to itself; remove it."
        if path.is_symlink():
            return (
                f"The link {shown(path)} points to {shown(path.readlink())}, which does not exist; "
                "remove the link or let it point to a mesh."
            )
        return f"The file {shown(path)} cannot be reached ({error.strerror})." if is_mesh else None
    if is_mesh and not stat.S_ISREG(mode):
        return f"The mesh {shown(path)} is no regular file; replace it by one."
    return None


def _called(relative: Path) -> tuple[str, str]:
    """What a mesh is called within its category, and the category, from its path below the root."""
    folders, stem = relative.parts[:-1], relative.stem
    if len(folders) >= 3 and folders[-1] == "models":  # ShapeNetCore
        return folders[-2], folders[-3]
    if not folders or folders == ("models",):
        return stem, stem
    parts = [*folders[1:], stem]  # <id>/model/model.stl is called <id>_model
    return "_".join(dict.fromkeys(parts)), folders[0]


def _name(category: str, ident: str) -> str:
    """A name that tells the category."""
    own = _plain(ident)
    name = own if own.casefold().startswith(category.casefold()) else f"{category}_{own}"
    if len(name.encode()) <= NAME_BYTES:
        return name
    cut = name.encode()[: NAME_BYTES - 9].decode("utf-8", "ignore")
    return f"{cut}-{digest(name)[:8]}"


def _plain(text: str) -> str:
    """The text without what has a meaning in MuJoCo's names, file names or our tables."""
    return "".join(c if c.isprintable() and c not in "/\\;" else "-" for c in text)


def _category_names(root: Path) -> dict[str, str]:
    """Readable categories by synset (ShapeNetCore) or by model id (ShapeNetSem)."""
    names: dict[str, str] = {}
    for file in (root / "taxonomy.json", root / "metadata.csv", root.parent / "metadata.csv"):
        if file.is_file():
            try:
                names |= _taxonomy(file) if file.suffix == ".json" else _metadata(file)
            except (OSError, ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
                raise SdfgcnError(
                    f"{shown(file)} cannot be read as ShapeNet's table of categories "
                    f"({type(error).__name__}: {error}); repair it, or remove it to take the "
                    "folders' names."
                ) from error
    return names


def _taxonomy(file: Path) -> dict[str, str]:
    entries = json.loads(file.read_text(encoding="utf-8"))
    return {entry["synsetId"]: entry["name"].split(",")[0] for entry in entries}


def _metadata(file: Path) -> dict[str, str]:
    names = {}
    with file.open(newline="", encoding="utf-8") as table:
        for row in csv.DictReader(table):
            first = (row.get("category") or "").split(",")[0]
            if row.get("fullId") and first:
                names[row["fullId"].removeprefix("wss.")] = first
    return names
