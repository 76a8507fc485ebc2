"""One job of a comparison: train a method with one seed if needed, then play its missing cells."""

from __future__ import annotations

from pathlib import Path

from sdfgcn.comparison.plan import DONE, Plan, cell_name, cells
from sdfgcn.compose import compose_config
from sdfgcn.config import QNetworkConfig
from sdfgcn.experiment import run_experiment, with_policy
from sdfgcn.registry import LOGGERS
from sdfgcn.run_folder import RunFolder, is_done
from sdfgcn.validation import typed


def run_job(plan: Plan, method: str, seed: int, folder: Path) -> None:
    """Train the method's network if it is missing, and play the cells that are missing.

    A method without a network does not depend on the seed: only the job with seed 0 plays it.

    Args:
        plan: The experiment.
        method: A key of the experiment's methods.
        seed: The training seed.
        folder: The job's folder; each cell is a run folder in it.

    Raises:
        SdfgcnError: The method is unknown, or a folder holds another experiment.
    """
    for cell in cells(plan.experiment):  # mistakes are told before anything is trained
        typed(compose_config(plan.evaluation(method, seed, cell, None)))
    policy = _trained(plan, method, seed)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / DONE).unlink(missing_ok=True)
    if policy is None and seed > 0:
        (folder / DONE).touch()
        return
    for cell in cells(plan.experiment):
        _play(plan.evaluation(method, seed, cell, policy), folder / cell_name(cell))
    (folder / DONE).touch()


def _trained(plan: Plan, method: str, seed: int) -> Path | None:
    """The folder of the method's policy, trained if needed; None without a network."""
    overrides = plan.training(method, seed)
    cfg = compose_config(overrides)
    config = typed(cfg)
    if not isinstance(config.model, QNetworkConfig):
        return None
    with RunFolder(plan.trainings(method) / f"seed_{seed}", cfg, overrides) as folder:
        logger = LOGGERS.find(config.logger.name)(config.logger, folder.path)
        checkpoint = with_policy(config, folder, logger).checkpoint
    assert checkpoint is not None
    return Path(checkpoint)


def _play(overrides: list[str], path: Path) -> None:
    """Play the missing episodes of a cell, and write its results."""
    cfg = compose_config(overrides)
    if is_done(path, cfg):
        return
    with RunFolder(path, cfg, overrides) as folder:
        run_experiment(typed(cfg), folder)
