"""Training checkpoints: a single archive, replaced atomically, with everything a resume needs.

It holds network, target network, optimiser, replay buffer, the state of the collector and of every
random generator, counters, and the config that they belong to.
"""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.checkpoint import Checkpoint, CheckpointError, GlobalRNGState

from sdfgcn.errors import SdfgcnError
from sdfgcn.files import replaced

NAME = "checkpoint.zip"


def save_checkpoint(path: Path, parts: Mapping[str, Any], config: Mapping[str, Any]) -> None:
    """Write a checkpoint; the previous one is kept until this one is complete.

    Args:
        path: The archive.
        parts: The parts by name: objects with a `state_dict` or, like replay buffers, `dumps`.
        config: The config that it belongs to, in JSON types.
    """
    # TorchRL moves the old archive away first: if killed just then, it would leave none.
    with replaced(path) as part:
        for left in path.parent.glob(f".{part.name}.*"):  # left by a killed process
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        _registered(parts).save(part, metadata={"config": config})


def checkpoint_config(path: Path) -> dict[str, Any]:
    """The config that a checkpoint belongs to.

    Raises:
        SdfgcnError: The file is not a training checkpoint.
    """
    try:
        return dict(Checkpoint.manifest(path)["metadata"]["config"])
    except Exception as error:
        raise _unreadable(path) from error


def load_checkpoint(path: Path, parts: Mapping[str, Any]) -> None:
    """Restore every part of a checkpoint.

    Args:
        path: The archive.
        parts: As for `save_checkpoint`; unusable if this raises.

    Raises:
        SdfgcnError: The file is damaged, or has other parts.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.testzip() is not None:
                raise CheckpointError("wrong checksum")
        _registered(parts).load(path)
    except Exception as error:  # damaged archives raise all kinds of errors
        raise _unreadable(path) from error


def _registered(parts: Mapping[str, Any]) -> Checkpoint:
    # A missing part is an error.
    checkpoint = Checkpoint(format="archive", archive_compression="deflate", strict="error")
    for name, part in {**parts, "rng": GlobalRNGState()}.items():
        checkpoint.register(name, part)
    return checkpoint


def _unreadable(path: Path) -> SdfgcnError:
    return SdfgcnError(
        f"{path} is damaged or no checkpoint of such a training; remove it to train anew, or use "
        "another hydra.run.dir."
    )
