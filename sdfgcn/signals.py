"""SIGTERM and SIGHUP end a run as Ctrl-C does, so that what is finished is kept.

Schedulers send SIGTERM before they kill a job, and a terminal that closes sends SIGHUP.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Iterator
from types import FrameType

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
PREEMPTION = (signal.SIGUSR1, signal.SIGUSR2)  # by which submitit is told that a job must go
GRACE = 10.0  # seconds that a worker outlives such a signal, so that its parent can end it


class Terminated(KeyboardInterrupt):
    """A signal asked this process to end; the message ends with its name.

    dm_control raises errors anew with words before their message.
    """

    @property
    def which(self) -> signal.Signals:
        """The signal."""
        return signal.Signals[str(self).split()[-1]]


def exit_code(error: KeyboardInterrupt) -> int:
    """The exit code of a process that ends by a signal: 130 after Ctrl-C, 143 after SIGTERM."""
    return 128 + (error.which if isinstance(error, Terminated) else signal.SIGINT)


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Raise `Terminated` in the block at the first of these signals, and ignore further ones.

    A signal that is handled or ignored already, such as by submitit or nohup, stays so. In another
    thread than the main one, nothing changes, as Python handles signals only there.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    free = [number for number in SIGNALS if signal.getsignal(number) is signal.SIG_DFL]

    def stop(number: int, frame: FrameType | None) -> None:
        for each in free:  # a second signal must not cut short what the first one began
            signal.signal(each, signal.SIG_IGN)
        raise Terminated(signal.Signals(number).name)

    for number in free:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in free:
            signal.signal(number, signal.SIG_DFL)


def leave_to_parent() -> None:
    """Leave Ctrl-C and other signals to the parent process, as all processes often get them.

    After a SIGTERM or SIGHUP, this process ends `GRACE` seconds later if the parent does not end it
    before: other libraries end workers by SIGTERM.
    """
    for number in (signal.SIGINT, *PREEMPTION):
        signal.signal(number, signal.SIG_IGN)
    for number in SIGNALS:
        signal.signal(number, _end_later)


def _end_later(number: int, frame: FrameType | None) -> None:
    timer = threading.Timer(GRACE, os._exit, (128 + number,))
    timer.daemon = True
    timer.start()
