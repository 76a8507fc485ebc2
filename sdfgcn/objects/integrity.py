"""What a cached object must be: checked when the cache is read, before anything is made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import SPLITS

_TEXTS = ("name", "category", "split", "file", "sha256")
_KEYS = {*_TEXTS, "mass", "rests"}
_OPTIONAL = {"uv", "texture"}
_ARRAYS = {"vertices", "faces", "points", "ends", *_OPTIONAL}


def check_entry(entry: Any) -> None:
    """Check an object's entry in the manifest.

    Raises:
        ValueError: It lacks a key or has another, or a value cannot be that of an object.
    """
    if not isinstance(entry, dict) or entry.keys() != _KEYS:
        raise ValueError("an object's entry has other keys than expected")
    name = entry["name"]
    if not all(isinstance(entry[key], str) for key in _TEXTS):
        raise ValueError(f"an entry of {name!r} that must be a text is none")
    if entry["file"] != f"{name}.npz" or "/" in name or "\\" in name:
        raise ValueError(f"the object {name!r} has the file {entry['file']!r}")
    if entry["split"] not in SPLITS:
        raise ValueError(f"the split of {name} is {entry['split']!r}")
    if not (_is_number(entry["mass"]) and entry["mass"] > 0):
        raise ValueError(f"the mass of {name} is {entry['mass']!r}")
    _check_rests(name, entry["rests"])


def _check_rests(name: str, rests: Any) -> None:
    if not (isinstance(rests, list) and rests and all(map(_is_rest, rests))):
        raise ValueError(f"the resting poses of {name} are {_short(rests)}")
    if not math.isclose(sum(rest[-1] for rest in rests), 1.0, abs_tol=1e-6):
        raise ValueError(f"the probabilities of the resting poses of {name} do not sum to 1")


def _is_rest(rest: Any) -> bool:
    """Whether this is a `Rest` in JSON: quaternion, height, radius, probability."""
    if not (isinstance(rest, list) and len(rest) == 4 and isinstance(rest[0], list)):
        return False
    quat, *values = rest
    if not (len(quat) == 4 and all(map(_is_number, [*quat, *values]))):
        return False
    height, radius, probability = values
    unit = math.isclose(math.hypot(*quat), 1.0, abs_tol=1e-6)
    return unit and height > 0 and radius > 0 and 0 <= probability <= 1


def check_arrays(arrays: Mapping[str, NDArray]) -> None:
    """Check the arrays of an object; see `ObjectModel` for their meaning.

    Raises:
        ValueError: An array is missing, has another type or shape, or values that cannot be.
    """
    if not _ARRAYS - _OPTIONAL <= arrays.keys() <= _ARRAYS:
        raise ValueError(f"its arrays are {', '.join(sorted(arrays)) or 'none'}")
    for name in ("vertices", "points"):
        _check(name, arrays[name], np.floating, (-1, 3))
    vertices, faces, ends = len(arrays["vertices"]), arrays["faces"], arrays["ends"]
    _check("faces", faces, np.integer, (-1, 3))
    _check("ends", ends, np.integer, (-1,))
    if faces.min() < 0 or faces.max() >= vertices:
        raise ValueError("its faces name vertices that there are not")
    if (np.diff(ends, prepend=0) < 4).any() or ends[-1] != len(arrays["points"]):
        raise ValueError("its pieces have other points than there are")
    if "uv" in arrays:
        _check("uv", arrays["uv"], np.floating, (vertices, 2))
    if "texture" in arrays:
        _check("texture", arrays["texture"], np.uint8, (-1, -1, 3))


def _check(name: str, array: NDArray, kind: type, shape: tuple[int, ...]) -> None:
    """Check type and shape, in which -1 stands for any size but 0."""
    fits = len(array.shape) == len(shape) and all(
        size == wanted or (wanted == -1 and size > 0)
        for size, wanted in zip(array.shape, shape, strict=False)
    )
    if not (fits and np.issubdtype(array.dtype, kind)):
        raise ValueError(f"its {name} are {array.dtype} {list(array.shape)}")
    if not np.isfinite(array).all():
        raise ValueError(f"its {name} are not finite")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
