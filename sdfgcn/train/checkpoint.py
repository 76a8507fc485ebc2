"""Training checkpoints: a single archive, replaced atomically, with everything a resume needs.

It holds network, target network, optimiser, replay buffer, the state of the collector and of every
random generator, counters, and the config that they belong to. The archive is TorchRL's; its files
are JSON and safetensors, which hold data only. No pickle is written, and none is read: a checkpoint
from someone else cannot run code.
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
from sdfgcn.train.archive import ArchiveError, check_archive
from sdfgcn.train.state_file import StateFileAdapter

NAME = "checkpoint.zip"


def save_checkpoint(path: Path, parts: Mapping[str, Any], config: Mapping[str, Any]) -> None:
    """Write a checkpoint; the previous one is kept until this one is complete.

    Args:
        path: The archive.
        parts: The parts by name, of lower-case letters: dicts in JSON types, and objects with a
            `state_dict` and a `load_state_dict` (see `StateFileAdapter`).
        config: The config that it belongs to, in JSON types.
    """
    # TorchRL moves the old archive away first: if killed just then, it would leave none.
    with replaced(path) as part:
        for left in path.parent.glob(f".{part.name}.*"):  # left by a killed process
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        _registered(parts).save(part, metadata={"config": config})


def checkpoint_config(path: Path, limit: int) -> dict[str, Any]:
    """The config that a checkpoint belongs to.

    Args:
        path: The archive.
        limit: The most bytes that it may take unpacked.

    Raises:
        SdfgcnError: The file is not a training checkpoint, or not made like one.
    """
    try:
        check_archive(path, limit)
        return dict(Checkpoint.manifest(path)["metadata"]["config"])
    except ArchiveError as error:
        raise _refused(path, error) from error
    except Exception as error:
        raise _unreadable(path) from error


def load_checkpoint(path: Path, parts: Mapping[str, Any], limit: int) -> None:
    """Restore every part of a checkpoint.

    Args:
        path: The archive.
        parts: As for `save_checkpoint`; unusable if this raises.
        limit: The most bytes that it may take unpacked.

    Raises:
        SdfgcnError: The file is damaged, has other parts, or is not made like a checkpoint.
    """
    try:
        check_archive(path, limit)
        with zipfile.ZipFile(path) as archive:
            if archive.testzip() is not None:
                raise CheckpointError("wrong checksum")
        _registered(parts).load(path)
    except ArchiveError as error:
        raise _refused(path, error) from error
    except Exception as error:  # damaged archives raise all kinds of errors
        raise _unreadable(path) from error


def _registered(parts: Mapping[str, Any]) -> Checkpoint:
    # A missing part is an error.
    checkpoint = Checkpoint(format="archive", archive_compression="deflate", strict="error")
    for name, part in {**parts, "rng": GlobalRNGState()}.items():
        adapter = None if isinstance(part, dict) else StateFileAdapter()  # TorchRL's own for JSON
        checkpoint.register(name, part, adapter=adapter)
    return checkpoint


def _refused(path: Path, reason: ArchiveError) -> SdfgcnError:
    return SdfgcnError(
        f"{path} {reason}, so it is not opened (it is of an earlier version, or may do harm); "
        "remove it to train anew, or use another hydra.run.dir."
    )


def _unreadable(path: Path) -> SdfgcnError:
    return SdfgcnError(
        f"{path} is damaged or no checkpoint of such a training; remove it to train anew, or use "
        "another hydra.run.dir."
    )
