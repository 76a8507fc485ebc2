"""Set-up shared by all worker processes."""

from __future__ import annotations

import multiprocessing
import os
import threading

from sdfgcn.signals import leave_to_parent


def follow_parent() -> None:
    """Leave Ctrl-C and other signals to the parent process, and exit when the parent does.

    Otherwise a worker would wait forever for work from a killed parent.
    """
    leave_to_parent()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
