"""The sweep of an experiment, in the process that launches its jobs."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf, open_dict

from sdfgcn.comparison import overview
from sdfgcn.comparison.plan import Plan, check, given
from sdfgcn.validation import typed


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
    """All jobs of an experiment: their overview while they run, and their report."""

    def __init__(self, config: DictConfig) -> None:
        """Start its overview; `config` has the key `hydra`."""
        job = config.hydra
        with open_dict(job):  # not set before the jobs
            job.runtime.cwd = str(Path.cwd())
        own = [str(key) for key in config if key != "hydra"]
        self._plan = plan_of_job(OmegaConf.masked_copy(config, own), job)
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


def plan_of_job(cfg: DictConfig, job: Any) -> Plan:
    """The experiment that a job or the launching process belongs to; `job` is Hydra's config.

    Raises:
        SdfgcnError: The experiment contradicts itself, or the command line contradicts it.
    """
    config = typed(cfg)
    trainings = config.experiment.trainings
    if Path.cwd() != Path(job.runtime.cwd):  # where a launcher starts its processes elsewhere
        trainings = str(Path(job.runtime.cwd) / trainings)
    experiment = replace(config.experiment, trainings=trainings)
    check(experiment)
    return Plan(experiment, config.budget, given(job.overrides.task, experiment))


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
