"""SIGTERM and a full disk: what is finished is kept, and the state says why the run ended."""

import errno
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from configs import compose_config
from filelock import FileLock

from sdfgcn.cli import to_sentence
from sdfgcn.evaluation.episodes import EpisodeResult
from sdfgcn.files import CsvTable, overwrite_json, write_json, write_text
from sdfgcn.run_folder import RunFolder, mark_stopped
from sdfgcn.signals import SIGNALS, Terminated, exit_code, stoppable

CONFIG = compose_config("objects=household", "model=rule_based")
EPISODE = EpisodeResult(0, 7, 2, "a;b", True, 3, 12.5, False, False, 1.5, 0.1)


def status(folder: Path) -> dict:
    return json.loads((folder / "status.json").read_text())


# ------------------------------------------------------------------ signals


@pytest.fixture
def default_signals() -> Iterator[None]:
    before = {number: signal.signal(number, signal.SIG_DFL) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("default_signals")
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_stops_a_block(number: signal.Signals) -> None:
    with pytest.raises(KeyboardInterrupt) as raised, stoppable(), stoppable():
        os.kill(os.getpid(), number)
        raise AssertionError("went on")
    assert str(raised.value) == number.name
    assert exit_code(raised.value) == 128 + number
    assert pickle.loads(pickle.dumps(raised.value)).which is number  # from a launcher's process
    assert type(raised.value)(f"while at it: {raised.value}").which is number  # by dm_control
    assert signal.getsignal(number) is signal.SIG_DFL


@pytest.mark.usefixtures("default_signals")
def test_a_second_signal_does_not_stop_what_the_first_began() -> None:
    ended = False
    with pytest.raises(Terminated), stoppable():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGHUP)
            ended = True
    assert ended


@pytest.mark.usefixtures("default_signals")
def test_signals_that_others_handle_stay_theirs() -> None:
    """Such as submitit's, and SIGHUP under nohup."""
    heard: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: heard.append(number))
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stoppable():
        os.kill(os.getpid(), signal.SIGTERM)
        os.kill(os.getpid(), signal.SIGHUP)
    assert heard == [signal.SIGTERM]


def test_only_the_main_thread_can_be_stopped() -> None:
    found: list[object] = []

    def look() -> None:
        with stoppable():
            found.append(signal.getsignal(signal.SIGTERM))

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert found == [before]


def test_exit_code_after_ctrl_c() -> None:
    assert exit_code(KeyboardInterrupt()) == 130


def test_a_worker_leaves_signals_to_its_parent_for_a_while() -> None:
    code = (
        "import sdfgcn.signals as s, os, time; s.GRACE = float('{grace}');"
        "s.leave_to_parent(); [os.kill(os.getpid(), n) for n in (2, *s.PREEMPTION, 15)];"
        "time.sleep(2); print('on')"
    )
    for grace, ends, out in (("60", 0, "on\n"), ("0", 128 + signal.SIGTERM, "")):
        done = subprocess.run(
            [sys.executable, "-c", code.format(grace=grace)], capture_output=True, text=True
        )
        assert (done.returncode, done.stdout) == (ends, out), done.stderr


# ------------------------------------------------------------------ the state that is left


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (KeyboardInterrupt(), "Interrupted from the keyboard; the same hydra.run.dir goes on"),
        (Terminated("SIGTERM"), "Stopped by SIGTERM; the same hydra.run.dir goes on"),
        (SystemExit(144), "Asked to exit with code 144, as by a scheduler; the same hydra.run.dir"),
    ],
)
def test_a_stopped_run_says_so(error: BaseException, told: str, tmp_path: Path) -> None:
    with pytest.raises(type(error)), RunFolder(tmp_path, CONFIG) as folder:
        folder.keep([EPISODE])
        raise error
    left = status(tmp_path)
    assert (left["state"], left["episodes"], left["traceback"]) == ("stopped", 1, None)
    assert left["error"].startswith(told)


def test_jobs_killed_by_a_stopped_sweep_are_marked(tmp_path: Path) -> None:
    """All that were running; not those that are, nor what is no state."""
    states = {"killed": "running", "ended": "done", "alive": "running", "a/b": "running"}
    for name, state in states.items():
        (tmp_path / name).mkdir(parents=True)
        write_json(tmp_path / name / "status.json", {"state": state, "episodes": 2})
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "status.json").write_text("{")
    with FileLock(tmp_path / "alive" / ".lock"):
        mark_stopped(tmp_path, Terminated("SIGTERM"))
    now = {name: status(tmp_path / name) for name in states}
    assert {name: each["state"] for name, each in now.items()} == {
        **states,
        "killed": "stopped",
        "a/b": "stopped",
    }
    assert now["killed"]["error"].startswith("Stopped by SIGTERM")
    assert now["killed"]["episodes"] == 2
    mark_stopped(tmp_path / "nowhere", KeyboardInterrupt())


# ------------------------------------------------------------------ a full disk


class FullDisk:
    """From the write of one file on, nothing can be written but in place."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, first: str, times: int = 0) -> None:
        self._first, self._skip, self.full = first, times, False
        fsync, append = os.fsync, CsvTable.append

        def checked_fsync(number: int) -> None:
            self._check(Path(f"/proc/self/fd/{number}").readlink().name)
            fsync(number)

        def checked_append(table: CsvTable, *rows: object) -> None:
            self._check(table._path.name)
            append(table, *rows)

        monkeypatch.setattr("sdfgcn.files.os.fsync", checked_fsync)
        monkeypatch.setattr(CsvTable, "append", checked_append)

    def _check(self, name: str) -> None:
        if name.removeprefix(".").replace(".part", "") == self._first:
            self._skip -= 1
            self.full |= self._skip < 0
        if self.full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize(
    ("first", "times"),
    [
        *(("config.yaml", 0), ("status.json", 0), ("status.json", 1), ("status.json", 2)),
        *(("episodes.csv", 0), ("episodes.csv", 1), ("episodes.csv", 2), ("results.json", 0)),
        *(("precision.json", 0), ("weights.safetensors", 0), ("policy.json", 0)),
        *(("train.csv", 0), ("metrics.csv", 0), ("checkpoint.zip", 0)),
    ],
)
@pytest.mark.parametrize("earlier", [False, True], ids=["new", "resumed"])
def test_no_run_is_running_on_a_full_disk(
    first: str, times: int, earlier: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever file is the first that does not fit, also if the process before was killed."""
    if earlier:
        with RunFolder(tmp_path, CONFIG):
            killed = (tmp_path / "status.json").read_text()
        (tmp_path / "status.json").write_text(killed)
        assert status(tmp_path)["state"] == "running"
    disk = FullDisk(monkeypatch, first, times)
    with pytest.raises(OSError, match="No space left") as raised:
        play_everything(tmp_path)
    assert disk.full
    if (tmp_path / "status.json").exists():
        left = status(tmp_path)
        assert (left["state"], left["error"]) == ("failed", "[Errno 28] No space left on device")
    else:
        assert not earlier
    told = to_sentence(raised.value)
    assert told is not None
    assert told.startswith("The disk is full ([Errno 28] No space left on device); make room")
    assert not list(tmp_path.glob(".*.part*"))


def play_everything(path: Path) -> None:
    """A run that writes every kind of file."""
    with RunFolder(path, CONFIG) as folder:
        for table in ("train.csv", "metrics.csv"):
            CsvTable(path / table, ("a",)).append({"a": 1})
        for file in ("precision.json", "policy.json"):
            write_json(path / file, {"a": 1})
        for file in ("checkpoint.zip", "weights.safetensors"):
            write_text(path / file, "a")
        folder.keep([EPISODE])
        folder.write_results({"a": 1})


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EDQUOT, os.strerror(errno.EDQUOT), "a.csv"),
        RuntimeError("I/O error: No space left on device (os error 28)"),
    ],
)
def test_libraries_have_errors_of_their_own_for_a_full_disk(error: Exception) -> None:
    told = to_sentence(error)
    assert told is not None
    assert told.startswith("The disk is full (")


def test_a_deleted_folder_keeps_its_error(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    with pytest.raises(FileNotFoundError, match=r"run/\.status"), RunFolder(folder, CONFIG) as run:
        (folder / "status.json").unlink()
        (folder / "config.yaml").unlink()
        (folder / ".lock").unlink()
        folder.rmdir()
        write_json(folder / "status.json", {})
    del run


def test_overwriting_leaves_nothing_of_what_was_longer(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"long": "a" * 1000})
    overwrite_json(tmp_path / "a.json", {"short": 1})
    assert json.loads((tmp_path / "a.json").read_text()) == {"short": 1}
    with pytest.raises(FileNotFoundError):
        overwrite_json(tmp_path / "b.json", {})
