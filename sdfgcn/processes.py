"""Set-up shared by all worker processes."""

from __future__ import annotations

import functools
import multiprocessing
import os
import threading
import time

from sdfgcn.signals import leave_to_parent

_LOOK = 0.5  # seconds between two looks whether the parent is still there


def follow_parent() -> None:
    """Leave Ctrl-C and other signals to the parent process, and exit when the parent does.

    Otherwise a worker would wait forever for work from a killed parent.
    """
    leave_to_parent()
    end_with_parent()


@functools.cache  # once in each process
def end_with_parent() -> None:
    """Exit when the process that started this one does; without such a process, do nothing.

    Otherwise joblib's processes would go on with their jobs, and hold their folders.
    """
    parent = multiprocessing.parent_process()
    if parent is not None and parent.pid is not None:
        threading.Thread(target=_end_after, args=(parent.pid,), daemon=True).start()


def _end_after(parent: int) -> None:
    # Not by `join`, which fails in joblib's processes.
    while os.getppid() == parent:
        time.sleep(_LOOK)
    os._exit(1)
