"""Runs of the command line in processes that are killed; used by `faults.py`."""

from __future__ import annotations

import multiprocessing.util
import os
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from common import ROOT

LIMIT = 600.0  # seconds after which a run counts as hanging
ORPHANS = 30.0  # seconds that a run's other processes may outlive it
LOOK = 0.05  # seconds between two looks at a process


@dataclass(frozen=True)
class Ended:
    """How a run ended.

    Attributes:
        code: Exit code, or minus the signal's number; None if it hung and was killed.
        struck: Whether it was still running when it was to be struck.
        orphans: Its processes that were still running 30 s later; they are killed.
        seconds: Its wall time.
        log: What it printed.
    """

    code: int | None
    struck: bool
    orphans: int
    seconds: float
    log: str


def run(
    arguments: Sequence[str],
    log: Path,
    strike: Callable[[int], None] | None = None,
    after: float = 0.0,
) -> Ended:
    """Run the command line in a process of its own, in a process group of its own.

    It is forked from this process, which has imported what takes seconds. OpenGL is not checked
    again.

    Args:
        arguments: As on the command line.
        log: The file for what it prints.
        strike: Called with the process id.
        after: Seconds until then.
    """
    began = time.monotonic()
    pid = os.fork()
    if pid == 0:
        _be_command(arguments, log)
    code, struck = None, False
    while code is None and time.monotonic() - began < LIMIT:
        if strike is not None and not struck and time.monotonic() - began >= after:
            struck = True
            strike(pid)
        ended, status = os.waitpid(pid, os.WNOHANG)
        if ended:
            code = os.waitstatus_to_exitcode(status)
        else:
            time.sleep(LOOK)
    seconds = time.monotonic() - began
    if code is None:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    return Ended(code, struck, _orphans(pid), seconds, log.read_text(errors="replace"))


def _be_command(arguments: Sequence[str], log: Path) -> None:
    """Become a process that runs the command line; does not return."""
    os.setsid()
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream in (1, 2):
        os.dup2(file, stream)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.argv = ["sdfgcn", *arguments]
    code = 1
    try:
        from sdfgcn import cli

        cli.check_opengl = lambda: None  # it takes as long as the rest
        cli.main()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1
    except BaseException:
        traceback.print_exc()
    # A process that ends by itself does these, after it would have gone on with this experiment.
    threading._shutdown()
    multiprocessing.util._exit_function()
    sys.stdout.flush()
    os._exit(code)


def _orphans(group: int) -> int:
    """Wait for the processes of a group to end; kill and count those that do not."""
    until = time.monotonic() + ORPHANS
    while left := _running(group):
        if time.monotonic() > until:
            for pid in left:
                os.kill(pid, signal.SIGKILL)
            return len(left)
        time.sleep(LOOK)
    return 0


def _running(group: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:  # it has just ended
            continue
        if int(its_group) == group and state != "Z":
            found.append(int(stat.parent.name))
    return found


def run_on_small_disk(arguments: Sequence[str], folder: Path, kilobytes: int) -> Ended | None:
    """Run the command line in a folder on a file system of so many kB; None if not permitted.

    Args:
        arguments: As on the command line, without its folder.
        folder: Receives `log` and a copy of the run's folder as `run`.
        kilobytes: The size.
    """
    folder.mkdir(parents=True)
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        return None
    (folder / "disk").mkdir()
    script = (
        'mount -t tmpfs -o "size=$1k" tmpfs "$2/disk" || exit 99; python=$3; shift 3; '
        f'"$python" -P "{ROOT}/run.py" "$@" "hydra.run.dir={folder}/disk" > "{folder}/log" 2>&1; '
        f'code=$?; cp -r "{folder}/disk" "{folder}/run"; exit $code'
    )
    began = time.monotonic()
    done = subprocess.run(
        [
            *("unshare", "-rm", "sh", "-c", script, "sh", str(kilobytes), str(folder)),
            *(sys.executable, *arguments),
        ],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=LIMIT,
    )
    log = (folder / "log").read_text(errors="replace")
    return Ended(done.returncode, done.returncode != 0, 0, time.monotonic() - began, log)
