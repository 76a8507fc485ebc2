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
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, TextIO

import hydra
import yaml
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import ConfigAttributeError, ConfigKeyError, OmegaConfBaseException

from sdfgcn.comparison import overview
from sdfgcn.comparison.plan import Plan, check, given
from sdfgcn.compose import component_dirs, conf_dir, register_search_path
from sdfgcn.config import Config
from sdfgcn.errors import SdfgcnError, tell_full_disk
from sdfgcn.evaluation.report import text
from sdfgcn.experiment import run_experiment
from sdfgcn.opengl import check_opengl
from sdfgcn.processes import end_with_parent
from sdfgcn.run_folder import RunFolder
from sdfgcn.signals import exit_code, stoppable
from sdfgcn.sweep import stopped_jobs_marked
from sdfgcn.validation import typed

_FULL_ERROR = "HYDRA_FULL_ERROR"


def main() -> None:
    """Run the command line.

    Raises:
        SystemExit: See `run_plainly`.
    """
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
        results = _evaluated(cfg, folder, job)
        beside = [_evaluated(other, folder / "baseline", job) for other in _baseline(cfg)]
    print(f"{text(results, beside)}\nRun folder: {folder}")
    return results["success_rate"]


def _evaluated(cfg: DictConfig, path: Path, job: Any) -> dict[str, Any]:
    with RunFolder(path, cfg, job.overrides.task) as folder:
        return run_experiment(_checked(cfg), folder)


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
    except KeyboardInterrupt as error:
        sys.exit(exit_code(error))
    except Exception as error:
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
    run_job(_plan(cfg, job), method, config.seed, Path(job.runtime.output_dir))


def _plan(cfg: DictConfig, job: Any) -> Plan:
    config = typed(cfg)
    trainings = config.experiment.trainings
    if Path.cwd() != Path(job.runtime.cwd):  # where a launcher starts its processes elsewhere
        trainings = str(Path(job.runtime.cwd) / trainings)
    experiment = replace(config.experiment, trainings=trainings)
    check(experiment)
    return Plan(experiment, config.budget, given(job.overrides.task, experiment))


class Comparison(Callback):
    """Shows how far the sweep of an experiment is, and makes its report at the end."""

    # Launchers pickle the callbacks, so what cannot be pickled is kept here.
    running: ClassVar[Sweep | None] = None
    finished: ClassVar[Sweep | None] = None  # if no job failed

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        """Start the overview."""
        Comparison.running = Sweep(config)

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        """Stop the overview."""
        if Comparison.running is not None:
            Comparison.running.overview.stop()
        Comparison.finished = Comparison.running


class Sweep:
    """The sweep of an experiment, in the process that launches its jobs."""

    def __init__(self, config: DictConfig) -> None:
        """Start its overview; `config` has the key `hydra`."""
        job = config.hydra
        with open_dict(job):  # not set before the jobs
            job.runtime.cwd = str(Path.cwd())
        own = [str(key) for key in config if key != "hydra"]
        self._plan = _plan(OmegaConf.masked_copy(config, own), job)
        self._folder = Path(job.sweep.dir)
        self._methods = _asked(job, "experiment.method")
        self._seeds = [int(seed) for seed in _asked(job, "seed")]
        every = overview.jobs(self._plan, self._folder, self._methods, self._seeds)
        os.environ["TQDM_DISABLE"] = "1"  # one line for all jobs instead of one for each
        self.overview = overview.Overview(self._plan, every)
        self.overview.start()

    def report(self) -> str:
        """Write the table, figures and rows into the sweep's folder; return the table."""
        from sdfgcn.comparison.report import write_report

        table = write_report(self._plan, self._folder, self._methods, self._seeds, self._folder)
        return f"{table}\nTable, figures and rows: {self._folder}"


def _asked(job: DictConfig, key: str) -> list[str]:
    """The values that a sweep gives to a key: the experiment's, or those of the command line."""
    values = str(job.sweeper.params[key])
    for override in job.overrides.task:
        name, _, value = override.partition("=")
        values = value if name == key else values
    parsed = OverridesParser.create().parse_override(f"{key}={values}")
    if parsed.is_sweep_override():
        return [str(value) for value in parsed.sweep_string_iterator()]
    return [str(parsed.value())]


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
    keys = _all_keys()
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


def _all_keys() -> set[str]:
    """All keys of all options."""
    keys = set(_keys(yaml.safe_load((conf_dir() / "config.yaml").read_text(encoding="utf-8"))))
    for folder in (conf_dir(), *component_dirs()):
        for file in folder.glob("*/*.yaml"):
            text = file.read_text(encoding="utf-8")
            header = re.match(r"# @package (\S+)", text)
            package = header[1] if header else file.parent.name
            keys.update(_keys(yaml.safe_load(text), "" if package == "_global_" else f"{package}."))
    return keys


def _keys(values: dict[str, Any], prefix: str = "") -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _keys(value, f"{prefix}{key}.")
        elif key != "defaults":
            yield f"{prefix}{key}"


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
