"""Evaluate a method: `python run.py --help` lists what can be set.

The run folder holds the resolved config, one row an episode, the results and the recordings.
"""

import os

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo loads: render without a display

from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from sdfgcn.cli import run_plainly
from sdfgcn.config import register_schema
from sdfgcn.experiment import run_experiment
from sdfgcn.report import text
from sdfgcn.run_folder import RunFolder
from sdfgcn.validation import typed

register_schema()


@hydra.main(config_path="conf", config_name="config", version_base="1.3")
def main(cfg: DictConfig) -> float:
    """Evaluate the configured model and print its row; return the success rate for a sweeper."""
    job = HydraConfig.get()
    with RunFolder(Path(job.runtime.output_dir), cfg, job.overrides.task) as folder:
        results = run_experiment(typed(cfg), folder)
    print(f"{text(results)}\nRun folder: {folder.path}")
    return results["success_rate"]


if __name__ == "__main__":
    run_plainly(main)
