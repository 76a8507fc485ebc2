"""One run from its config to its results, in its run folder."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict, replace
from typing import Any

from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.evaluation.evaluate import Evaluation, HeldOutEvaluation, evaluate, watch
from sdfgcn.evaluation.results import summarise
from sdfgcn.loggers import Logger
from sdfgcn.registry import LOGGERS, RECORDERS
from sdfgcn.run_folder import RunFolder


def run_experiment(config: Config, folder: RunFolder) -> dict[str, Any]:
    """Train if the model is to be trained, play the missing episodes, write the results of all.

    Returns the content of `results.json`.

    Raises:
        SdfgcnError: What it needs is not there: the objects, room for a layout.
    """
    from sdfgcn.objects.catalogue import load_catalogue  # loads MuJoCo: it fails without OpenGL

    load_catalogue(config.env.objects, config.env.split)  # once, before workers would each do it
    logger = LOGGERS.find(config.logger.name)(config.logger, folder.path)
    if isinstance(config.model, QNetworkConfig):
        config = with_policy(config, folder, logger)
    evaluation = Evaluation(
        config,
        folder.path / "recordings",
        RECORDERS.find(config.viz.name),
    )
    finished = folder.finished
    missing = evaluate(evaluation, {episode.episode for episode in finished})
    episodes = folder.keep(watch(missing, finished, config.eval.episodes, logger))
    results = summarise(config, episodes, folder.wall_s)
    folder.write_results(results)
    return results


def with_policy(config: Config, folder: RunFolder, logger: Logger) -> Config:
    """The config with the checkpoint that a Q-network is evaluated from; trained if there is none.

    A trained policy goes into the folder `policy` of the run folder.

    Raises:
        SdfgcnError: The checkpoint given is no policy; or see `sdfgcn.train.training.train`.
    """
    from sdfgcn.agents.policy import ABOUT, RELEASED, find_policy, read_about  # loads torch

    if config.checkpoint is not None:
        found = find_policy(config.checkpoint)
        if found.parent == RELEASED:  # its name says more than where it is installed
            return config
        return replace(config, checkpoint=str(found))
    policy = folder.path / "policy"
    budget = asdict(config.budget)
    if not (policy / ABOUT).exists() or read_about(policy)["budget"] != budget:
        from sdfgcn.train.training import train_policy

        with closing(HeldOutEvaluation(config)) as held_out:
            train_policy(config, folder.path, policy, logger, held_out)
    return replace(config, checkpoint=str(policy))
