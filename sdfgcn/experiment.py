"""One run from its config to its results, in its run folder."""

from __future__ import annotations

from typing import Any

from sdfgcn.config import Config, lookup
from sdfgcn.evaluate import Evaluation, evaluate, watch
from sdfgcn.loggers import LOGGERS
from sdfgcn.opengl import check_opengl
from sdfgcn.results import summarise
from sdfgcn.runs import RunFolder
from sdfgcn.viz import RECORDERS


def run_experiment(config: Config, folder: RunFolder) -> dict[str, Any]:
    """Play the episodes that the folder lacks, and write the results over all of them.

    Args:
        config: The whole experiment.
        folder: The run folder, held open.

    Returns:
        The content of `results.json`.

    Raises:
        SdfgcnError: What it needs is not there: OpenGL, the objects, room for a layout.
    """
    check_opengl()
    from sdfgcn.objects.catalogue import load_catalogue  # loads MuJoCo: it fails without OpenGL

    load_catalogue(config.env.objects, config.env.split)  # once, before workers would each do it
    evaluation = Evaluation(
        config,
        folder.path / "recordings",
        lookup(RECORDERS, "viz.name", config.viz.name),
    )
    logger = lookup(LOGGERS, "logger.name", config.logger.name)(folder.path)
    finished = folder.finished
    missing = evaluate(evaluation, {episode.episode for episode in finished})
    episodes = folder.keep(watch(missing, finished, config.eval.episodes, logger))
    results = summarise(config, episodes, folder.wall_s)
    folder.write_results(results)
    return results
