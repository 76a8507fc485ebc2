"""How `run.py` speaks when something is wrong: one sentence on stderr, exit code 1."""

from __future__ import annotations

import contextlib
import difflib
import errno
import logging
import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TextIO

from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from sdfgcn.config import Config
from sdfgcn.errors import SdfgcnError

_FULL_ERROR = "HYDRA_FULL_ERROR"
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)
_CONF = Path(__file__).resolve().parents[1] / "conf"


def run_plainly(main: Callable[[], Any]) -> None:
    """Run a Hydra application; a mistake the user can mend becomes one sentence on stderr.

    With the environment variable HYDRA_FULL_ERROR=1, and for any other error, there is the
    traceback.

    Args:
        main: The function that `hydra.main` decorated.

    Raises:
        SystemExit: Code 1 after such a sentence, 130 after Ctrl-C.
    """
    if os.environ.get(_FULL_ERROR) == "1":
        main()
        return
    os.environ[_FULL_ERROR] = "1"  # Hydra raises then, instead of printing lines of its own
    try:
        with contextlib.redirect_stderr(_WithoutPreamble(sys.stderr)):
            main()
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        sentence = to_sentence(error)
        if sentence is None:
            raise
        print(sentence, file=sys.stderr)
        sys.exit(1)


def to_sentence(error: BaseException) -> str | None:
    """Tell an error in one sentence, or return None for one the user cannot mend."""
    if isinstance(error, SdfgcnError):
        return str(error)
    if isinstance(error, MissingConfigException):
        return _tell_missing_option(error)
    if isinstance(error, HydraException | OmegaConfBaseException):
        return _tell_config_error(error)
    for link in _causes(error):  # Hydra makes the run folder and opens its log there
        if isinstance(link, OSError) and (link.filename or link.errno in _DISK_FULL):
            return (
                f"Cannot use {link.filename or 'the run folder'} ({link.strerror}); choose "
                "another folder with hydra.run.dir=... (hydra.sweep.dir=... for a sweep)."
            )
    return None


class LogFailedJob(Callback):
    """Logs a job of a sweep that fails, since Hydra raises only the first one's error."""

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Log the job's error, if it has one."""
        if job_return.status is JobStatus.FAILED and HydraConfig.get().mode is RunMode.MULTIRUN:
            error = job_return._return_value  # the public property raises it
            overrides = " ".join(job_return.overrides or ())
            logging.getLogger(__name__).error("%s failed: %s", overrides, error)


class _WithoutPreamble:
    """Stderr without the line that Hydra writes before it raises a job's error."""

    def __init__(self, stderr: TextIO) -> None:
        self._stderr = stderr

    def write(self, text: str) -> int:
        if text.startswith("Error executing job with overrides"):
            return len(text)
        return self._stderr.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stderr, name)


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__


def _tell_missing_option(error: MissingConfigException) -> str:
    """Hydra lists the options one a line, and its search path."""
    group, _, option = (error.missing_cfg_file or "").rpartition("/")
    if not error.options:
        return _as_sentence(_gist(error))
    return f"There is no {group}={option}: {group} can be {', '.join(error.options)}."


def _tell_config_error(error: BaseException) -> str:
    """Hydra names the override, and OmegaConf, mostly as its cause, the key and what is wrong."""
    override = re.search(r"Could not override '([^']+)'", str(error))
    for link in _causes(error):
        key = re.search(r"full_key: (\S+)", str(link))
        if key and isinstance(link, ConfigKeyError | ConfigAttributeError):
            asked = (override or key)[1]
            return f"There is no key '{asked}'; {_hint(asked)}"
        if key:
            return _as_sentence(f"{key[1]}: {_gist(link)}")
    if isinstance(error, OverrideParseException):
        lines = str(error.message).splitlines()
        detail = next(line for line in lines if not line.startswith(("Error parsing", "See ")))
        return _as_sentence(f"Cannot read the override '{error.override}': {detail}")
    return _as_sentence(_gist(error))


def _hint(asked: str) -> str:
    """Name the keys or the group that was probably meant."""
    meant: dict[str, list[str]] = {}
    for key in _keys(OmegaConf.structured(Config)):
        parts = key.split(".")
        for start in range(len(parts)):
            meant.setdefault(".".join(parts[start:]), []).append(key)
    meant |= {group.name: [group.name] for group in _CONF.glob("*/")}
    close = difflib.get_close_matches(asked, meant, n=1, cutoff=0.8)
    if not close:
        return "`run.py --cfg job` prints all keys."
    depth = min(key.count(".") for key in meant[close[0]])
    nearest = [key for key in meant[close[0]] if key.count(".") == depth]
    return f"did you mean {' or '.join(nearest)}?"


def _keys(cfg: DictConfig, prefix: str = "") -> Iterator[str]:
    for key in map(str, cfg):
        if OmegaConf.is_missing(cfg, key) or not OmegaConf.is_dict(cfg[key]):
            yield f"{prefix}{key}"
        else:
            yield from _keys(cfg[key], f"{prefix}{key}.")


def _gist(error: BaseException) -> str:
    """The line that says what is wrong: the last before OmegaConf's details, else the first."""
    before, details, _ = str(error).strip().partition("full_key:")
    line = before.strip().splitlines()[-1 if details else 0]
    return line.strip().rstrip(".").replace(". ", "; ")


def _as_sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."
