"""The exception for errors that the user can fix."""

from __future__ import annotations

import errno
import os


class SdfgcnError(Exception):
    """An error that the user can fix, described in one sentence.

    The sentence says what is wrong, which value was given and what would work. The command `sdfgcn`
    prints it on stderr without a traceback and exits with code 1.
    """


def tell_full_disk(error: BaseException) -> str | None:
    """One sentence if an error comes of a full disk or quota; libraries have errors of their own.

    Args:
        error: Of Python, or of a library in C++ or Rust, with the system's words in its message.
    """
    words = [os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT)]
    if not any(each in str(error) for each in words):
        return None
    reason = str(error).strip().splitlines()[0].rstrip(".")
    return (
        f"The disk is full ({reason}); make room and give the same command the same "
        "hydra.run.dir=... (hydra.sweep.dir=... for a sweep), which goes on from what is there, or "
        "choose another folder."
    )
