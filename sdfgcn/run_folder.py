"""The run folder: config, state, episodes, results and recordings of one run.

A run may be interrupted at any moment. Its `status.json` then reads `done` (only once the results
are written), `stopped` or `failed` with the reason, or `running` with its process id if the process
was killed.
A run with the same `hydra.run.dir` resumes from the episodes in the folder.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout
from omegaconf import DictConfig, OmegaConf

from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.episodes import EpisodeResult, EpisodeTable
from sdfgcn.files import overwrite_json, write_json, write_text
from sdfgcn.signals import Terminated

# Keys that change how a run is executed or shown, but not its episodes.
_FREE_KEYS = (
    *("runtime.", "viz.", "logger.", "experiment.", "eval.name", "eval.episodes"),
    *("eval.baseline", "env.reward.name", "train.env.reward.name"),
)


class RunFolder:
    """Holds a run folder for the duration of one run; use it as a context manager."""

    def __init__(self, path: Path, cfg: DictConfig, overrides: Sequence[str] = ()) -> None:
        """Set the folder; nothing is read or written before `__enter__`.

        Args:
            path: The folder; it is created if needed.
            cfg: The run's config.
            overrides: The command line's overrides, kept in `status.json`.
        """
        self.path = path
        self._cfg = cfg
        self._table = EpisodeTable(path / "episodes.csv")
        self._lock = FileLock(path / ".lock")
        self._status: dict[str, Any] = {"overrides": list(overrides)}
        self._n_episodes = 0
        self._earlier_s = 0.0
        self._clock = 0.0

    def __enter__(self) -> RunFolder:
        """Lock the folder, check that its episodes belong to this config, mark it running.

        Raises:
            SdfgcnError: Another process uses it, or its episodes are from another experiment.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        try:
            self._lock.acquire(timeout=0)
        except Timeout:
            raise SdfgcnError(
                f"Another process is running in {self.path}; wait for it or use another "
                "hydra.run.dir."
            ) from None
        try:
            earlier = self._table.read()
            if earlier:
                self._check_same_experiment(len(earlier))
            self._begin(len(earlier))
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Write the final state and release the folder."""
        try:
            if error is None:
                self._or_tell(lambda: self._write_status(state="done", ended=_now()))
            else:
                self._tell(error)
        finally:
            self._lock.release()

    @property
    def wall_s(self) -> float:
        """Wall time spent on this folder, seconds, including time before a restart."""
        return round(self._earlier_s + time.monotonic() - self._clock, 3)

    @property
    def finished(self) -> list[EpisodeResult]:
        """The episodes in the folder, sorted by index."""
        return self._table.read()

    def keep(self, episodes: Iterable[EpisodeResult]) -> list[EpisodeResult]:
        """Save each episode as it arrives, in any order.

        Returns:
            All episodes in the folder, sorted by index, as in the rewritten `episodes.csv`.
        """
        for episode in episodes:
            self._table.append(episode)
            self._n_episodes += 1
            self._write_status()
        every = self._table.read()
        self._table.write(every)
        return every

    def write_results(self, results: dict[str, Any]) -> None:
        """Write `results.json`."""
        write_json(self.path / "results.json", results)

    def _begin(self, n_earlier: int) -> None:
        self._clock = time.monotonic()
        if n_earlier:
            self._earlier_s = _earlier_seconds(self.path / "status.json")
            self._n_episodes = n_earlier
        self._or_tell(self._mark_running)

    def _mark_running(self) -> None:
        (self.path / "results.json").unlink(missing_ok=True)
        write_text(self.path / "config.yaml", OmegaConf.to_yaml(self._cfg, resolve=True))
        self._write_status(
            state="running",
            pid=os.getpid(),
            host=socket.gethostname(),
            started=_now(),
            ended=None,
            error=None,
            traceback=None,
        )

    def _or_tell(self, write: Callable[[], None]) -> None:
        """Write something; if that fails, such as on a full disk, the run has failed."""
        try:
            write()
        except OSError as error:
            self._tell(error)
            raise

    def _tell(self, error: BaseException) -> None:
        """Write that the run was stopped or failed, and why."""
        news = {"ended": _now(), "error": _reason(error), **_ending(error)}
        try:
            self._write_status(**news)
        except OSError:  # on a full disk, an existing file can still be overwritten
            with contextlib.suppress(OSError):  # where even the folder is gone
                overwrite_json(self.path / "status.json", {**self._status, "traceback": None})

    def _check_same_experiment(self, n_earlier: int) -> None:
        kept = self.path / "config.yaml"
        if not kept.exists():
            raise SdfgcnError(
                f"{self.path} holds {n_earlier} episodes but no config.yaml to say of which "
                "experiment; use another hydra.run.dir."
            )
        now = OmegaConf.create(OmegaConf.to_yaml(self._cfg, resolve=True))
        if differing := differences(_binding(OmegaConf.load(kept)), _binding(now)):
            raise SdfgcnError(
                f"{self.path} holds {n_earlier} episodes of another experiment, which differs in "
                f"{differing}; use the same values or another hydra.run.dir."
            )
        if n_earlier > self._cfg.eval.episodes:
            raise SdfgcnError(
                f"{self.path} holds {n_earlier} episodes already, more than eval.episodes="
                f"{self._cfg.eval.episodes}; ask for at least as many or use another hydra.run.dir."
            )

    def _write_status(self, **news: Any) -> None:
        self._status |= {**news, "episodes": self._n_episodes, "wall_s": self.wall_s}
        write_json(self.path / "status.json", self._status)


def is_done(path: Path, cfg: DictConfig) -> bool:
    """Whether a folder holds the results of just this run, with all its episodes."""
    status, results, kept = (path / name for name in ("status.json", "results.json", "config.yaml"))
    if not (status.exists() and results.exists() and kept.exists()):
        return False
    state = json.loads(status.read_text(encoding="utf-8"))
    if state.get("state") != "done" or state.get("episodes") != cfg.eval.episodes:
        return False
    now = OmegaConf.create(OmegaConf.to_yaml(cfg, resolve=True))
    return _binding(OmegaConf.load(kept)) == _binding(now)


def _binding(cfg: Any) -> dict[str, Any]:
    """A config with dotted keys, without those that do not affect episodes."""
    values: Any = OmegaConf.to_container(cfg)
    return {key: value for key, value in flat(values).items() if not key.startswith(_FREE_KEYS)}


def _earlier_seconds(status: Path) -> float:
    """Return the wall time of earlier processes, seconds, from the last status, if it is whole."""
    try:
        return float(json.loads(status.read_text(encoding="utf-8")).get("wall_s", 0.0))
    except (FileNotFoundError, ValueError):
        return 0.0


def mark_stopped(root: Path, error: BaseException) -> None:
    """Mark the run folders below `root` whose processes were killed while they ran.

    A sweep that is stopped kills its jobs before they can do so themselves.

    Args:
        root: Where to look; it need not exist.
        error: What stopped the sweep.
    """
    for file in root.rglob("status.json"):
        # Skipped if it is locked by a process that is still running, or cannot be read or written.
        with (
            contextlib.suppress(OSError, ValueError, Timeout),
            FileLock(file.with_name(".lock"), timeout=0),
        ):
            status = json.loads(file.read_text(encoding="utf-8"))
            if status.get("state") == "running":
                news = {"ended": _now(), "error": _reason(error), **_ending(error)}
                write_json(file, {**status, **news})


def _ending(error: BaseException) -> dict[str, Any]:
    """The state after an error, and its traceback unless someone stopped the run."""
    if isinstance(error, KeyboardInterrupt | SystemExit):  # a scheduler's library raises the latter
        return {"state": "stopped", "traceback": None}
    return {"state": "failed", "traceback": "".join(traceback.format_exception(error))}


def _reason(error: BaseException) -> str:
    if isinstance(error, KeyboardInterrupt | SystemExit):
        how = "Interrupted from the keyboard"
        if isinstance(error, Terminated):
            how = f"Stopped by {error.which.name}"
        elif isinstance(error, SystemExit):
            how = f"Asked to exit with code {error.code}, as by a scheduler"
        return f"{how}; the same hydra.run.dir goes on from here."
    return str(error).strip().partition("\n")[0] or type(error).__name__


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
