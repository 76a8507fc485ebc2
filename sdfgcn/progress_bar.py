"""Progress with the time left: a live line on a terminal, otherwise a line every ten seconds."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

from tqdm import tqdm

SECONDS = 10.0  # s, between lines where there is no terminal


def progress_bar(
    items: Iterable | None = None,
    *,
    unit: str,
    total: int | None = None,
    initial: int = 0,
    desc: str | None = None,
) -> tqdm:
    """Show progress and the time left on stderr.

    On a terminal, one line is redrawn. Elsewhere (a file, a scheduler, a notebook's log) lines are
    written: none in the first ten seconds, then one every ten seconds, also while a single item
    takes long, and a last one at the end.

    Args:
        items: What to iterate over; without it, call `update` for each item that is done.
        unit: What one item is called.
        total: Number of items; by default that of `items`.
        initial: Number of items already done.
        desc: What is being done.

    Returns:
        An iterable over `items` and a context manager, see tqdm.
    """
    kind = tqdm if sys.stderr.isatty() else _Lines
    return kind(items, unit=unit, total=total, initial=initial, desc=desc)


class _Lines(tqdm):
    """Writes a line from time to time instead of redrawing one."""

    def __init__(self, items: Iterable | None, **options: Any) -> None:
        self._over = threading.Event()
        # Only the thread writes: tqdm itself would write nothing while an item takes long.
        options |= {"file": _LineFile(sys.stderr), "mininterval": math.inf, "delay": SECONDS}
        super().__init__(items, **options)
        threading.Thread(target=self._write, daemon=True).start()

    def __iter__(self) -> Iterator:
        with self:
            for item in self.iterable:
                yield item
                self.update()

    def _write(self) -> None:
        while not self._over.wait(SECONDS):
            self.last_print_t = time.time()  # so that tqdm also writes a line at the end
            self.refresh()

    def close(self) -> None:
        """Write the last line if there was one before."""
        self._over.set()
        super().close()


class _LineFile:
    """Turns what tqdm writes to redraw its line into lines of their own."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, text: str) -> None:
        """Write the text as a line, without the control characters around it."""
        line = text.strip()
        if line:
            self._file.write(f"{line}\n")

    def flush(self) -> None:
        """Flush the file."""
        self._file.flush()
