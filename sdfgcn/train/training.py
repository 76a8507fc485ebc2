"""From a config to a trained network: builds a training, or resumes it from a checkpoint."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch

from sdfgcn.agents.policy import read_about, save_policy
from sdfgcn.agents.policy_file import ABOUT
from sdfgcn.config import Config, EnvConfig
from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.loggers import Logger
from sdfgcn.models import build_q_network, q_networks
from sdfgcn.models.q_network import QNetwork
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.provenance import provenance
from sdfgcn.task.push_space import PushSpace
from sdfgcn.train.checkpoint import NAME, checkpoint_config, load_checkpoint
from sdfgcn.train.collectors import CollectorSpec, build_collector
from sdfgcn.train.curriculum import Curriculum, ObjectCountSampler
from sdfgcn.train.exploration import EpsilonGreedyPolicy
from sdfgcn.train.held_out import Evaluate, HeldOutCurve
from sdfgcn.train.hindsight import Hindsight
from sdfgcn.train.learners import build_learner
from sdfgcn.train.progress import Progress
from sdfgcn.train.replay import Replay
from sdfgcn.train.trainer import KeepNetwork, Spent, Trainer, TrainingState

# Builds a network from the whole config and the number of rows that it is trained on.
BuildNetwork = Callable[[Config, int], QNetwork]

# Parts of the config that affect what is learned; the rest may change on a resume.
_LEARNING = ("seed", "n_objects", "model", "train", "curriculum", "her", "augment")
_FREE = tuple(
    f"train.{key}"
    for key in (
        *("log_pushes", "checkpoint_minutes", "sdf_cache", "eval_pushes", "eval_episodes"),
        *("env.scenario.max_tries", "env.reward.name"),
    )
)


def train(
    config: Config,
    folder: Path,
    logger: Logger,
    build_network: BuildNetwork,
    keep_network: KeepNetwork = lambda network, spent: None,
    evaluate: Evaluate | None = None,
) -> QNetwork:
    """Train a Q-network; resume if the folder holds a checkpoint.

    Torch's global random state is left unchanged.

    Args:
        config: The whole experiment.
        folder: The run folder, for `train.csv` and the checkpoint.
        logger: Receives running metrics.
        build_network: Builds the untrained network.
        keep_network: Called with the network, as returned, at each checkpoint and at the end.
        evaluate: Plays held-out episodes every `train.eval_pushes`.

    Returns:
        The trained network with averaged weights, on the CPU.

    Raises:
        SdfgcnError: The checkpoint is damaged or belongs to another training.
    """
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports every storage it creates
    threads = torch.get_num_threads()
    with torch.random.fork_rng():
        torch.set_num_threads(config.runtime.torch_threads)
        torch.manual_seed(config.seed)
        try:
            with closing(
                build_trainer(config, folder, logger, build_network, keep_network, evaluate)
            ) as trainer:
                trainer.run()
                return trainer.averaged
        finally:
            torch.set_num_threads(threads)


def train_policy(
    config: Config, folder: Path, policy: Path, logger: Logger, evaluate: Evaluate | None = None
) -> None:
    """Train the Q-network that the config names, and write it as a policy.

    The policy is written from the first checkpoint on; its `budget` is null until training ends.

    Args:
        config: The whole experiment.
        folder: The run folder.
        policy: The folder for the policy.
        logger: Receives running metrics.
        evaluate: Plays held-out episodes every `train.eval_pushes`.

    Raises:
        SdfgcnError: See `train`.
    """
    env = config.train.env
    load_catalogue(env.objects, env.split)  # once, before each worker would do it
    kept: list[tuple[QNetwork, Spent]] = []

    def keep(network: QNetwork, spent: Spent, budget: dict[str, Any] | None = None) -> None:
        about = {"budget": budget, "spent": spent, "seed": config.seed, **provenance()}
        save_policy(policy, network, {**about, "training": learning_config(config)})
        kept[:] = [(network, spent)]

    train(config, folder, logger, q_network, keep, evaluate)
    keep(*kept[0], training_budget(config))


def training_budget(config: Config) -> dict[str, Any]:
    """The part of the budget on which a training's result depends."""
    budget = config.budget
    return {key: getattr(budget, key) for key in ("pushes", "minutes", "epsilon_pushes")}


def is_trained(config: Config, policy: Path) -> bool:
    """Whether a folder holds the policy of just this training.

    Raises:
        SdfgcnError: It holds that of another training, of the same budget.
    """
    if not (policy / ABOUT).exists():
        return False
    about = read_about(policy)
    if about["budget"] != training_budget(config):
        return False  # not finished, or to be continued
    if told := differences(about["training"], learning_config(config)):
        raise SdfgcnError(
            f"{policy} is of another training, which differs in {told}; use the same values or "
            "another folder."
        )
    return True


def q_network(config: Config, rows: int) -> QNetwork:
    """The untrained network that the config names."""
    env = config.train.env
    return build_q_network(
        config.model, env.push.directions, rows, env.arena.image_size, config.seed
    )


def build_trainer(
    config: Config,
    folder: Path,
    logger: Logger,
    build_network: BuildNetwork,
    keep_network: KeepNetwork,
    evaluate: Evaluate | None,
) -> Trainer:
    """Build the parts of a training, and restore the folder's checkpoint, if any; see `train`."""
    counts = ObjectCountSampler(config.curriculum, config.n_objects)
    env = training_env(config, counts)
    actions = PushSpace(env.push, env.arena).spec(env.max_objects)
    network = build_network(config, env.max_objects)
    learner = build_learner(network, actions, config.train, config.runtime.device)
    state = TrainingState(
        learner,
        EpsilonGreedyPolicy(network, actions, config.train, config.budget.epsilon_pushes),
        Replay(config),
        Hindsight(config.her, env),
        Curriculum(config.curriculum, counts),
        Progress(folder, logger, config.train.log_pushes, learner.metrics),
    )
    collector_state = _restored(state, folder / NAME, config)
    curve = HeldOutCurve(folder, logger, config.train.eval_pushes, evaluate)
    curve.go_on_from(state.progress.pushes)
    with torch.random.fork_rng():  # otherwise a resumed training would draw other numbers
        pushes = state.progress.pushes
        collector = build_collector(
            CollectorSpec(config, env, counts, state.policy.module, pushes, collector_state)
        )
    kept = learning_config(config)
    return Trainer(config, state, collector, curve, folder / NAME, kept, keep_network)


def _restored(state: TrainingState, checkpoint: Path, config: Config) -> dict[str, Any]:
    """Load the checkpoint, if there is one; return the collector's state."""
    collector: dict[str, Any] = {}
    if checkpoint.exists():
        check_same_learning(checkpoint, state.largest, config)
        load_checkpoint(checkpoint, state.parts(collector), state.largest)
        state.policy.load_weights(state.learner.network)
        if not (collector and config.collector.name == "sync"):
            state.progress.forget_episode()
            state.hindsight.forget_episode()
    return collector


def training_env(config: Config, counts: ObjectCountSampler) -> EnvConfig:
    """The training env's config, with no more rows than needed if the network allows it.

    Args:
        config: The whole experiment.
        counts: Holds the numbers of objects.
    """
    env, most = config.train.env, max(counts.counts)
    fixed = q_networks()[config.model.name].fixed_rows
    return replace(env, n_objects=most, max_objects=env.max_objects if fixed else most)


def learning_config(config: Config) -> dict[str, Any]:
    """The config values that affect what is learned, flat and in JSON types."""
    values = {part: value for part, value in asdict(config).items() if part in _LEARNING}
    return {key: value for key, value in flat(values).items() if not key.startswith(_FREE)}


def check_same_learning(path: Path, limit: int, config: Config) -> None:
    """Check that a checkpoint belongs to a config.

    Args:
        path: The checkpoint.
        limit: The most bytes that it may take unpacked.
        config: The whole experiment.

    Raises:
        SdfgcnError: It belongs to another, and the message names the keys that differ; or it
            cannot be read.
    """
    told = differences(checkpoint_config(path, limit), learning_config(config))
    if told:
        raise SdfgcnError(
            f"{path} is of another training, which differs in {told}; use the same values or "
            "another hydra.run.dir."
        )
