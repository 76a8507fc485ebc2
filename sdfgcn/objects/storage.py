"""The catalogue cache: one .npz per object, and a manifest written last.

The manifest holds the checksum of every .npz and one of its own entries. Whatever is read is also
checked for what an object must be, as a cache without damage may still be of other hands.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from numpy.typing import NDArray

from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.integrity import check_arrays, check_entry
from sdfgcn.objects.model import ObjectModel, Rest

MANIFEST = "manifest.json"


def cache_dir() -> Path:
    """Return `SDFGCN_CACHE` if set, else the platform's cache folder for sdfgcn."""
    chosen = os.environ.get("SDFGCN_CACHE")
    return Path(chosen).expanduser() if chosen else Path(platformdirs.user_cache_dir("sdfgcn"))


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Yield a scratch folder that is atomically renamed to `target` on success.

    If another process created `target` first, its result is kept and ours discarded.

    Raises:
        SdfgcnError: The cache directory is not writable.
    """
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise SdfgcnError(
            f"The cache directory {target.parent} cannot be written ({error.strerror}); set "
            "SDFGCN_CACHE to a folder that can."
        ) from error
    try:
        yield scratch
        try:
            scratch.rename(target)
        except OSError:
            if not target.is_dir():
                raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def write_models(target: Path, models: list[ObjectModel]) -> None:
    """Write both splits of a catalogue; the folder appears complete or not at all."""
    with new_folder(target) as scratch:
        entries = []
        for model in models:
            content = _pack(model)
            file = f"{model.name}.npz"
            (scratch / file).write_bytes(content)
            entries.append(
                {
                    "name": model.name,
                    "category": model.category,
                    "split": model.split,
                    "mass": model.mass,
                    "rests": [astuple(rest) for rest in model.rests],
                    "file": file,
                    "sha256": hashlib.sha256(content).hexdigest(),
                }
            )
        manifest = {"sha256": _checksum(entries), "objects": entries}
        (scratch / MANIFEST).write_text(json.dumps(manifest, indent=1))


def read_models(folder: Path, split: str) -> tuple[ObjectModel, ...]:
    """Read one split of a cached catalogue, checking every file against the manifest.

    Raises:
        SdfgcnError: A file is missing, truncated or altered, or holds what is no object.
    """
    with _damage_named(folder, folder / MANIFEST):
        entries = _entries(json.loads((folder / MANIFEST).read_text(encoding="utf-8")))
        mine = [entry for entry in entries if entry["split"] == split]
    return tuple(_read_model(folder, entry) for entry in mine)


def _entries(manifest: Any) -> list[dict]:
    """The objects of a manifest, checked.

    Caches of before there was a checksum of the manifest have none, and need not be built anew.
    """
    if not (isinstance(manifest, dict) and manifest.keys() <= {"sha256", "objects"}):
        raise ValueError("it is no manifest of a catalogue")
    entries = manifest["objects"]
    if manifest.get("sha256", None) not in (None, _checksum(entries)):
        raise ValueError("its checksum does not match its entries")
    for entry in entries:
        check_entry(entry)
    return entries


def _checksum(entries: list[dict]) -> str:
    return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()


def _read_model(folder: Path, entry: dict) -> ObjectModel:
    path = folder / f"{entry['name']}.npz"
    with _damage_named(folder, path):
        content = path.read_bytes()
        if hashlib.sha256(content).hexdigest() != entry["sha256"]:
            raise ValueError("its checksum does not match the manifest")
        return _unpack(content, entry)


@contextmanager
def _damage_named(folder: Path, path: Path) -> Iterator[None]:
    try:
        yield
    except Exception as error:  # damaged files raise all kinds of errors
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise SdfgcnError(
            f"The object cache file {path} is damaged ({reason}); delete the folder {folder} and "
            "run again to rebuild it."
        ) from error


def _pack(model: ObjectModel) -> bytes:
    arrays: dict[str, NDArray] = {"vertices": model.vertices, "faces": model.faces}
    arrays["points"] = np.concatenate(model.pieces)
    arrays["ends"] = np.cumsum([len(piece) for piece in model.pieces])
    arrays |= {} if model.uv is None else {"uv": model.uv}
    arrays |= {} if model.texture is None else {"texture": model.texture}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _unpack(content: bytes, entry: dict) -> ObjectModel:
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        check_arrays(dict(arrays))
        return ObjectModel(
            name=entry["name"],
            category=entry["category"],
            split=entry["split"],
            vertices=arrays["vertices"],
            faces=arrays["faces"],
            uv=arrays.get("uv"),
            texture=arrays.get("texture"),
            pieces=tuple(np.split(arrays["points"], arrays["ends"][:-1])),
            mass=entry["mass"],
            rests=tuple(Rest(tuple(quat), *rest) for quat, *rest in entry["rests"]),
        )
