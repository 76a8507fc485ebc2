"""The command `sdfgcn`: train if needed, evaluate, write a run folder; `--help` lists its keys.

The run folder holds the config, a row per episode, the results and the recordings. An error the
user can fix is one sentence on stderr, with exit code 1.
"""

from __future__ import annotations

import contextlib
import difflib
import logging
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TextIO

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, open_dict
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from sdfgcn.callbacks import how_to_go_on
from sdfgcn.comparison.sweep import Comparison, plan_of_job
from sdfgcn.compose import conf_dir, register_search_path
from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.errors import SdfgcnError, tell_full_disk
from sdfgcn.evaluation.report import text
from sdfgcn.experiment import run_experiment
from sdfgcn.help import all_keys, help_text
from sdfgcn.opengl import check_opengl
from sdfgcn.processes import end_with_parent
from sdfgcn.run_folder import RunFolder
from sdfgcn.signals import exit_code, stoppable
from sdfgcn.sweep import stopped_jobs_marked
from sdfgcn.validation import typed

_FULL_ERROR = "HYDRA_FULL_ERROR"
_TRAINING = ("train", "budget", "collector", "curriculum", "her", "augment")  # groups


def main() -> None:
    """Run the command line.

    Raises:
        SystemExit: See `run_plainly`.
    """
    if {"-h", "--help"} & set(sys.argv[1:]):  # Hydra's own has no comments, and composes first
        print(help_text())
        return
    register_search_path()
    run_plainly(_command)


def _command() -> None:
    with stopped_jobs_marked():
        hydra.main(str(conf_dir()), "config", version_base="1.3")(run)()
    if Comparison.finished is not None:
        print(Comparison.finished.report())


def run(cfg: DictConfig) -> float | None:
    """Evaluate the configured model and print its row; return the success rate for a sweeper.

    In an experiment, train and evaluate one of its methods instead.
    """
    job = HydraConfig.get()
    end_with_parent()  # a launcher may have started this process
    with stoppable():
        if cfg.experiment.name != "none":
            _run_in_comparison(cfg, job)
            return None
        folder = Path(job.runtime.output_dir)
        results = _evaluated(cfg, folder, job, tell=True)
        beside = [_evaluated(other, folder / "baseline", job) for other in _baseline(cfg)]
    print(f"{text(results, beside)}\nRun folder: {folder}")
    return results["success_rate"]


def _evaluated(cfg: DictConfig, path: Path, job: Any, tell: bool = False) -> dict[str, Any]:
    with RunFolder(path, cfg, job.overrides.task) as folder:
        config = _checked(cfg)
        if tell and (told := without_effect(config, job.overrides.task)):
            logging.getLogger(__name__).warning(told)
        return run_experiment(config, folder)


def without_effect(config: Config, overrides: Sequence[str]) -> str | None:
    """Say which overrides of a run are for training, if nothing is trained; None if none are."""
    if isinstance(config.model, QNetworkConfig) and config.checkpoint is None:
        return None
    keys = {override: override.lstrip("+~").partition("=")[0] for override in overrides}
    idle = [
        override for override, key in keys.items() if key.startswith(_TRAINING) or "@train." in key
    ]
    if config.runtime.device != "cpu":
        idle.append(f"runtime.device={config.runtime.device}")
    return f"Without effect, as nothing is trained: {', '.join(idle)}." if idle else None


def _baseline(cfg: DictConfig) -> list[DictConfig]:
    """The config of the agent that plays the same scenes; none if no other one is asked for."""
    name = cfg.eval.baseline
    if name is None or name == cfg.model.name:
        return []
    other = cfg.copy()
    with open_dict(other):
        other.model = {"name": name}
        other.checkpoint = other.eval.baseline = None
        other.viz = {"name": "none", "episodes": 0}
    return [other]


def _checked(cfg: DictConfig) -> Config:
    """The typed config, where MuJoCo can render: checking it imports MuJoCo."""
    try:
        with warnings.catch_warnings(action="ignore"):  # such as GLFW's, of a missing display
            config = typed(cfg)
    except (AttributeError, ImportError, RuntimeError):  # of MuJoCo without OpenGL
        check_opengl()
        raise
    check_opengl()
    return config


def run_plainly(main: Callable[[], Any]) -> None:
    """Run a `hydra.main` function; an error the user can fix becomes one sentence on stderr.

    Any other error shows its traceback, as does every error if HYDRA_FULL_ERROR=1 is set.

    Raises:
        SystemExit: Code 1 after such a sentence, 130 after Ctrl-C, 143 after SIGTERM.
    """
    if os.environ.get(_FULL_ERROR) == "1":
        with stoppable():
            main()
        return
    os.environ[_FULL_ERROR] = "1"  # makes Hydra raise instead of printing its own message
    try:
        with contextlib.redirect_stderr(_WithoutPreamble(sys.stderr)), stoppable():
            main()
    except (KeyboardInterrupt, Exception) as error:
        interrupt = _interrupt(error)
        if interrupt is not None:
            print(how_to_go_on(interrupt), file=sys.stderr)
            sys.exit(exit_code(interrupt))
        sentence = to_sentence(error)
        if sentence is None:
            raise
        print(sentence, file=sys.stderr)
        sys.exit(1)


def to_sentence(error: BaseException) -> str | None:
    """Describe an error in one sentence; None if the user cannot fix it."""
    if isinstance(error, SdfgcnError):
        return str(error)
    if isinstance(error, MissingConfigException):
        return _tell_missing_option(error)
    if isinstance(error, HydraException | OmegaConfBaseException):
        return _tell_config_error(error)
    for link in _causes(error):  # Hydra creates the run folder and opens its log there
        if told := tell_full_disk(link):
            return told
        if isinstance(link, OSError) and link.filename:
            return (
                f"Cannot use {link.filename} ({link.strerror}); choose another folder with "
                "hydra.run.dir=... (hydra.sweep.dir=... for a sweep)."
            )
    return None


def _run_in_comparison(cfg: DictConfig, job: Any) -> None:
    """Train and evaluate one method of an experiment, with one seed."""
    from sdfgcn.comparison.job import run_job

    config = _checked(cfg)
    name, method = config.experiment.name, config.experiment.method
    if method is None:
        raise SdfgcnError(
            f"experiment is '{name}' but experiment.method is null, as it is if several "
            "experiments are asked for at once; run one experiment a call: "
            f"python run.py -m experiment={name}."
        )
    run_job(plan_of_job(cfg, job), method, config.seed, Path(job.runtime.output_dir))


class LogFailedJob(Callback):
    """Logs every failed job of a sweep, since Hydra raises only the first error."""

    def on_job_end(self, config: DictConfig, job_return: JobReturn, **kwargs: Any) -> None:
        """Log the job's error, if it has one."""
        if job_return.status is JobStatus.FAILED and HydraConfig.get().mode is RunMode.MULTIRUN:
            error = job_return._return_value  # the public property raises it
            overrides = " ".join(job_return.overrides or ())
            logging.getLogger(__name__).error("%s failed: %s", overrides, error)


class _WithoutPreamble:
    """Stderr without the line that Hydra prints before it raises a job's error."""

    def __init__(self, stderr: TextIO) -> None:
        self._stderr = stderr

    def write(self, text: str) -> int:
        if text.startswith("Error executing job with overrides"):
            return len(text)
        return self._stderr.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stderr, name)


def _interrupt(error: BaseException | None) -> KeyboardInterrupt | None:
    """Ctrl-C or a signal, if that is behind an error: OmegaConf raises another one over it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__


def _tell_missing_option(error: MissingConfigException) -> str:
    """Shorten Hydra's message, which prints one option per line and its search path."""
    group, _, option = (error.missing_cfg_file or "").rpartition("/")
    if not error.options:
        return _as_sentence(_gist(error))
    return f"There is no {group}={option}: {group} can be {', '.join(error.options)}."


def _tell_config_error(error: BaseException) -> str:
    """Hydra's error names the override; its cause, mostly OmegaConf's, the key and the problem."""
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
    """Suggest the keys or the group that was probably meant."""
    meant: dict[str, list[str]] = {}
    keys = all_keys()
    if asked in keys:
        return "it belongs to another option of its group."
    for key in keys:
        parts = key.split(".")
        for start in range(len(parts)):
            meant.setdefault(".".join(parts[start:]), []).append(key)
    meant |= {group.name: [group.name] for group in conf_dir().glob("*/")}
    close = difflib.get_close_matches(asked, meant, n=1, cutoff=0.8)
    if not close:
        return "`--cfg job` prints all keys."
    depth = min(key.count(".") for key in meant[close[0]])
    nearest = sorted(key for key in meant[close[0]] if key.count(".") == depth)
    return f"did you mean {' or '.join(nearest)}?"


def _gist(error: BaseException) -> str:
    """The line that states the problem: the last before OmegaConf's details, else the first."""
    before, details, _ = str(error).strip().partition("full_key:")
    line = before.strip().splitlines()[-1 if details else 0]
    line = re.sub(r"Invalid value assigned: \w+ is not a ListConfig.*", "must be a list", line)
    return line.strip().rstrip(".").replace(". ", "; ")


def _as_sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."


if __name__ == "__main__":
    main()
