"""Compare agents: `python -m sdfgcn.compare checkpoint=push_model,outputs/DATE/TIME,rule_based`.

Each agent plays the same scenes with the same help, in a run folder of its own below that of the
command. The first `viz.episodes` scenes are filmed and recorded with the agents side by side.
`--help` lists what can be set. An error the user can fix is one sentence on stderr, exit code 1.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from sdfgcn.cli import run_plainly
from sdfgcn.compose import compose_config, conf_dir, register_search_path
from sdfgcn.config import Config, QNetworkConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.evaluate import Evaluation, evaluate
from sdfgcn.evaluation.report import agents_text
from sdfgcn.experiment import run_experiment
from sdfgcn.opengl import check_opengl
from sdfgcn.registry import MODELS, RECORDERS
from sdfgcn.run_folder import RunFolder
from sdfgcn.validation import typed
from sdfgcn.viz.comparison import check_comparable, draw_comparison
from sdfgcn.viz.records import Episode, Records

CONFIG = "compare"  # in conf/
_KEY = "checkpoint="


@dataclass(frozen=True)
class Agent:
    """One of the agents.

    Attributes:
        title: Its name in films and tables, and of its folder.
        overrides: What picks it.
        cfg: The config with which it plays.
        config: The same, checked.
    """

    title: str
    overrides: tuple[str, ...]
    cfg: DictConfig
    config: Config


def main() -> None:
    """Run the command line.

    Raises:
        SystemExit: See `sdfgcn.cli.run_plainly`.
    """
    register_search_path()
    sys.argv[1:] = [_quoted(argument) for argument in sys.argv[1:]]
    run_plainly(hydra.main(str(conf_dir()), CONFIG, version_base="1.3")(compare))


def compare(cfg: DictConfig) -> None:
    """Let the agents of `checkpoint` play, draw their first scenes, and print a row for each."""
    job = HydraConfig.get()
    folder = Path(job.runtime.output_dir)
    check_opengl()
    agents = find_agents(cfg.checkpoint, job.overrides.task)
    check_comparable(agents[0].config.viz)
    results = {agent.title: _played(agent, folder / agent.title) for agent in agents}
    _draw(agents, folder)
    print(f"{agents_text(results)}\nRun folder: {folder}")


def find_agents(entries: str | None, overrides: Sequence[str]) -> list[Agent]:
    """The agents that the command line asks for, all of them checked.

    Args:
        entries: Released names, run folders and agents without weights, with commas between.
        overrides: Those of the command line, which hold for every agent.

    Raises:
        SdfgcnError: An entry is none of these, or its config contradicts itself.
    """
    names = [entry.strip() for entry in (entries or "").split(",") if entry.strip()]
    if len(names) < 2 or max(Counter(names).values()) > 1:
        raise SdfgcnError(
            f"checkpoint is '{entries}', but a comparison needs two or more different agents with "
            "commas between, such as checkpoint=push_model,rule_based."
        )
    if picked := [override for override in overrides if override.startswith("model=")]:
        raise SdfgcnError(
            f"{picked[0]} has no effect in a comparison; name the agents in checkpoint=..., which "
            "also takes agents without weights, such as rule_based."
        )
    shared = [override for override in overrides if not override.startswith(_KEY)]
    agents = []
    for title, name in zip(_titles(names), names, strict=True):
        own = (*shared, *_picking(name))
        cfg = compose_config(own, CONFIG)
        agents.append(Agent(title, own, cfg, typed(cfg)))
    return agents


def _quoted(argument: str) -> str:
    """The argument, with the value of `checkpoint` as one word: Hydra would sweep over it."""
    if argument.startswith(_KEY) and "," in argument and argument[len(_KEY)] not in "'\"":
        return f"{_KEY}'{argument.removeprefix(_KEY)}'"
    return argument


def _picking(name: str) -> tuple[str, ...]:
    """The overrides that pick an agent."""
    from sdfgcn.agents.policy import ABOUT, RELEASED, find_policy  # loads torch

    plain = [key for key in MODELS if not issubclass(MODELS.config_type(key), QNetworkConfig)]
    if name in plain:
        return (f"model={name}", "checkpoint=null")
    try:
        find_policy(name)
    except SdfgcnError:
        released = sorted(path.parent.name for path in RELEASED.glob(f"*/{ABOUT}"))
        raise SdfgcnError(
            f"checkpoint names '{name}', which is neither released ({', '.join(released)}), nor "
            f"an agent without weights ({', '.join(plain)}), nor a folder with a trained policy."
        ) from None
    return ("model=released", f"checkpoint='{name}'")


def _titles(names: Sequence[str]) -> list[str]:
    """A short title for each: the last part of a folder, with more of it where others share it."""
    titles = [Path(name).name for name in names]
    counts = Counter(titles)
    return [
        "-".join(Path(name).parts[-2:]) if counts[title] > 1 else title
        for name, title in zip(names, titles, strict=True)
    ]


def _played(agent: Agent, path: Path) -> dict[str, Any]:
    with RunFolder(path, agent.cfg, agent.overrides) as folder:
        return run_experiment(agent.config, folder, RECORDERS["none"])


def _draw(agents: Sequence[Agent], folder: Path) -> None:
    """Draw the first scenes, unless an earlier run has."""
    first = agents[0].config
    for episode in range(min(first.viz.episodes, first.eval.episodes)):
        path = folder / "recordings" / f"episode_{episode:03d}"
        if not list(path.parent.glob(f"{path.name}.*")):
            episodes = {agent.title: _played_again(agent.config, episode) for agent in agents}
            draw_comparison(path, first.env, first.viz, episodes)


def _played_again(config: Config, episode: int) -> Episode:
    """The records of an episode that was played before; it goes the same way again."""
    records = Records()
    here = replace(config, runtime=replace(config.runtime, workers=0))
    others = set(range(config.eval.episodes)) - {episode}
    list(evaluate(Evaluation(here, Path(), lambda *_: records), others))
    assert records.episode is not None
    return records.episode


if __name__ == "__main__":
    main()
