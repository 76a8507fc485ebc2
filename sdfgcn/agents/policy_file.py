"""The two files of a policy, checked before they are used: `ABOUT` (JSON), `WEIGHTS` (safetensors).

Neither can hold code. But they may be damaged or come from someone else, and without the checks,
weights that are not finite or belong to another network would give pushes that mean nothing.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load
from torch import Tensor

WEIGHTS = "weights.safetensors"
ABOUT = "policy.json"

# Everything that `ABOUT` may say.
KEYS = (
    *("sha256", "model", "directions", "max_objects", "image_size"),
    *("budget", "spent", "seed", "versions", "git", "training"),
)
# The least and the most of the numbers that the network is built with.
_RANGES = {"directions": (4, 360), "max_objects": (1, 256), "image_size": (1, 4096)}
_WIDEST = 4096  # of any whole number in `model`: layers, channels, rings

log = logging.getLogger(__name__)


class PolicyFileError(ValueError):
    """What is wrong with a policy's files, as a clause."""


def read_about(folder: Path) -> dict[str, Any]:
    """Read and check `ABOUT`; it may be incomplete.

    Raises:
        PolicyFileError: It is not in JSON, has a key that no policy has, or a number that makes no
            sense.
        OSError: It cannot be read.
    """
    try:
        about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise PolicyFileError(f"{ABOUT} is not in JSON") from error
    if not isinstance(about, dict):
        raise PolicyFileError(f"{ABOUT} is not a JSON object")
    if unknown := sorted(about.keys() - set(KEYS)):
        raise PolicyFileError(f"{ABOUT} has the unknown key '{unknown[0]}'")
    for key, (least, most) in _RANGES.items():
        if key in about:
            _check_whole(key, about[key], least, most)
    _check_model(about.get("model", {}))
    _check_training(about.get("training", {}))
    return about


def _check_model(model: Any) -> None:
    if not isinstance(model, dict):
        raise PolicyFileError(f"model is {model!r}, but must be an object")
    for key, value in _numbers("model", model):
        if not math.isfinite(value):
            raise PolicyFileError(f"{key} is {value}, but must be finite")
        if isinstance(value, int) and abs(value) > _WIDEST:
            raise PolicyFileError(f"{key} is {value}, but no network has more than {_WIDEST}")


def _check_training(training: Any) -> None:
    if not isinstance(training, dict):
        raise PolicyFileError(f"training is {training!r}, but must be an object")
    counts = training.get("curriculum.counts", [])
    if not isinstance(counts, list):
        raise PolicyFileError(f"training.curriculum.counts is {counts!r}, but must be a list")
    for count in [*counts, training.get("n_objects", 1)]:
        _check_whole("a number of objects in training", count, *_RANGES["max_objects"])


def _check_whole(key: str, value: Any, least: int, most: int) -> None:
    if not (type(value) is int and least <= value <= most):
        raise PolicyFileError(
            f"{key} is {value!r}, but must be a whole number from {least} to {most}"
        )


def _numbers(key: str, value: Any) -> Iterator[tuple[str, float]]:
    """All numbers in a JSON value, with their dotted keys."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _numbers(f"{key}.{name}", item)
    elif isinstance(value, list):
        for item in value:
            yield from _numbers(key, item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield key, value


def read_weights(
    folder: Path, about: Mapping[str, Any], wanted: Mapping[str, Tensor]
) -> dict[str, Tensor]:
    """Read and check `WEIGHTS`.

    Args:
        folder: The policy's.
        about: From `read_about`. Without its `sha256`, as of policies written before there was one,
            a warning says that damage of the weights may go unnoticed.
        wanted: Tensors of the network's names, shapes and types.

    Raises:
        PolicyFileError: The checksum is another, the weights are of another network, or not finite.
        OSError: The file cannot be read.
        safetensors.SafetensorError: It is no safetensors file.
    """
    content = (folder / WEIGHTS).read_bytes()
    if "sha256" not in about:
        log.warning(
            "The policy in %s was written without a checksum, so damage of its weights may go "
            "unnoticed.",
            folder,
        )
    elif checksum(content) != about["sha256"]:
        raise PolicyFileError(f"{WEIGHTS} does not have the checksum in {ABOUT}")
    weights = load(content)
    if differing := sorted(weights.keys() ^ wanted.keys()):
        raise PolicyFileError(
            f"only one of {WEIGHTS} and the network of {ABOUT} has '{differing[0]}'"
        )
    for name, value in weights.items():
        there, here = ((each.dtype, list(each.shape)) for each in (value, wanted[name]))
        if there != here:
            raise PolicyFileError(f"'{name}' is {_told(*there)}, but {_told(*here)} in the network")
        if value.is_floating_point() and not torch.isfinite(value).all():
            raise PolicyFileError(f"'{name}' is not finite")
    return weights


def checksum(weights: bytes) -> str:
    """The checksum of the content of `WEIGHTS`, for `ABOUT`."""
    return hashlib.sha256(weights).hexdigest()


def _told(dtype: torch.dtype, shape: list[int]) -> str:
    return f"{str(dtype).removeprefix('torch.')} {shape}"
