"""One run, from its config to its results, in its run folder."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Any

from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.evaluation.evaluate import (
    Evaluation,
    HeldOutEvaluation,
    MakeRecorder,
    evaluate,
    watch,
)
from sdfgcn.evaluation.results import summarise
from sdfgcn.loggers import Logger
from sdfgcn.registry import LOGGERS, RECORDERS
from sdfgcn.run_folder import RunFolder


def run_experiment(
    config: Config, folder: RunFolder, make_recorder: MakeRecorder | None = None
) -> dict[str, Any]:
    """Train if needed, play the missing episodes and write the results of all episodes.

    Args:
        config: The whole config.
        folder: Where everything is written.
        make_recorder: Records the first episodes; None stands for what `config.viz` names.

    Returns:
        The content of `results.json`.

    Raises:
        SdfgcnError: The objects are not available, or a layout does not fit on the table.
    """
    from sdfgcn.objects.catalogue import load_catalogue  # loads MuJoCo, which needs OpenGL

    load_catalogue(config.env.objects, config.env.split)  # once, rather than in every worker
    logger = LOGGERS.find(config.logger.name)(config.logger, folder.path)
    if isinstance(config.model, QNetworkConfig):
        config = with_policy(config, folder, logger)
    evaluation = Evaluation(
        config,
        folder.path / "recordings",
        make_recorder or RECORDERS.find(config.viz.name),
    )
    finished = folder.finished
    missing = evaluate(evaluation, {episode.episode for episode in finished})
    episodes = folder.keep(watch(missing, finished, config.eval.episodes, logger))
    results = summarise(config, episodes, folder.wall_s)
    folder.write_results(results)
    return results


def with_policy(config: Config, folder: RunFolder, logger: Logger) -> Config:
    """The config with the checkpoint to evaluate; a Q-network without one is trained first.

    The trained policy is saved in `policy` of the run folder.

    Raises:
        SdfgcnError: The given checkpoint is not a policy; or see `sdfgcn.train.training.train`.
    """
    from sdfgcn.agents.policy import RELEASED, find_policy  # loads torch

    if config.checkpoint is not None:
        found = find_policy(config.checkpoint)
        if found.parent == RELEASED:  # its name is more telling than its installed path
            return config
        return replace(config, checkpoint=str(found))
    from sdfgcn.train.training import is_trained, train_policy

    policy = folder.path / "policy"
    if not is_trained(config, policy):
        with closing(HeldOutEvaluation(config)) as held_out:
            train_policy(config, folder.path, policy, logger, held_out)
    return replace(config, checkpoint=str(policy))
