"""What a checkpoint's archive may hold, checked before anything in it is read.

The archive may come from someone else. It is checked against what a checkpoint has, not against
what is known to be harmful: its files by name, each an ordinary file that begins as its kind does,
and all of them no larger than the training's own could be.
"""

from __future__ import annotations

import re
import stat
import zipfile
from pathlib import Path

from sdfgcn.train.state_file import STRUCTURE, TENSORS

# The manifest and a part in JSON are TorchRL's; see `torchrl.checkpoint`.
_NAMES = re.compile(
    rf"manifest\.json|components/[0-9]{{4}}-[a-z]+/(value\.json|{re.escape(STRUCTURE)}|"
    rf"{re.escape(TENSORS)})"
)
# A checkpoint's largest JSON file is the list of a network's tensors, some 10 kB.
JSON_BYTES = 2**24
_ENCRYPTED = 0x1


class ArchiveError(Exception):
    """The archive holds something that no checkpoint has; the message says what, as a clause."""


def check_archive(path: Path, limit: int) -> None:
    """Check that an archive is made like a checkpoint.

    Args:
        path: The archive.
        limit: The most bytes that its files may have in all when unpacked.

    Raises:
        ArchiveError: It is not.
        OSError: It cannot be read.
        zipfile.BadZipFile: It is no archive, or damaged.
    """
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        _check_names([member.filename for member in members])
        for member in members:
            _check_kind(member)
        size = sum(member.file_size for member in members)
        if size > limit:
            raise ArchiveError(
                f"would take {size / 2**20:.0f} MB unpacked, but one of this training takes at "
                f"most {limit / 2**20:.0f} MB"
            )
        for member in members:
            _check_start(archive, member)


def _check_names(names: list[str]) -> None:
    seen = set()
    for name in names:
        if not _NAMES.fullmatch(name):
            raise ArchiveError(f"holds {name!r}, which no checkpoint of this version has")
        if name in seen:
            raise ArchiveError(f"holds {name!r} twice")
        seen.add(name)


def _check_kind(member: zipfile.ZipInfo) -> None:
    if stat.S_IFMT(member.external_attr >> 16) not in (0, stat.S_IFREG):  # 0: not told
        raise ArchiveError(f"holds {member.filename!r}, which is no ordinary file")
    # The other ways of compression can unpack to more than they declare.
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ArchiveError(f"holds {member.filename!r}, which is compressed in another way")
    if member.flag_bits & _ENCRYPTED:
        raise ArchiveError(f"holds {member.filename!r}, which is encrypted")
    if member.filename.endswith(".json") and member.file_size > JSON_BYTES:
        raise ArchiveError(f"holds {member.filename!r} of {member.file_size / 2**20:.0f} MB")


def _check_start(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Check that a file begins like its kind, and so not like a pickle or another archive."""
    with archive.open(member) as file:
        start = file.read(9)
    if member.filename.endswith(".json"):
        good = start.startswith(b"{")
    else:  # safetensors: the length of the header, and the header in JSON
        good = start[8:] == b"{" and int.from_bytes(start[:8], "little") <= member.file_size - 8
    if not good:
        raise ArchiveError(f"holds {member.filename!r}, whose content is of another kind")
