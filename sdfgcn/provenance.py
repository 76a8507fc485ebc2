"""What a result depends on besides its config: package versions and the commit."""

from __future__ import annotations

import platform
import subprocess
from importlib import metadata
from pathlib import Path
from typing import Any

# Packages that a result depends on.
_PACKAGES = (
    "sdfgcn",
    "mujoco",
    "dm-control",
    "torch",
    "torchrl",
    "tensordict",
    "numpy",
    "scipy",
    "scikit-fmm",
    "hydra-core",
)
_ROOT = Path(__file__).resolve().parents[1]


def provenance() -> dict[str, Any]:
    """The package `versions` and the state of the checkout, `git`, in JSON types."""
    return {"versions": versions(), "git": git_state(_ROOT)}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a result depends on."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:  # run from the source tree, not installed
            continue
    return found


def git_state(root: Path) -> dict[str, Any] | None:
    """Return the commit of a source tree, and whether its files differ from it.

    Returns:
        `commit` and `dirty`, or None if `root` is not the top of a git checkout.
    """
    top = _git(root, "rev-parse", "--show-toplevel")
    commit = _git(root, "rev-parse", "HEAD")
    if top is None or commit is None or Path(top) != root:
        return None
    return {"commit": commit, "dirty": bool(_git(root, "status", "--porcelain"))}


def _git(root: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
