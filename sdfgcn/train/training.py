"""From a config to a trained network: what a training is made of, and what it belongs to."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch

from sdfgcn.agents.policy import save_policy
from sdfgcn.config import Config, EnvConfig
from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.loggers import Logger
from sdfgcn.models import build_q_network, q_networks
from sdfgcn.models.q_network import QNetwork
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.task.push_space import PushSpace
from sdfgcn.train.checkpoint import NAME, checkpoint_config, load_checkpoint
from sdfgcn.train.collectors import CollectorSpec, build_collector
from sdfgcn.train.curriculum import Curriculum, ObjectCountSampler
from sdfgcn.train.exploration import EpsilonGreedyPolicy
from sdfgcn.train.held_out import Evaluate, HeldOutCurve
from sdfgcn.train.hindsight import Hindsight
from sdfgcn.train.learner import Learner
from sdfgcn.train.progress import Progress
from sdfgcn.train.replay import Replay
from sdfgcn.train.trainer import Trainer, TrainingState

# Builds a network from the whole config and the number of rows that it is trained with.
BuildNetwork = Callable[[Config, int], QNetwork]
# Takes the network, on the CPU, whenever there is a new checkpoint.
KeepNetwork = Callable[[QNetwork], None]

# Parts of the config that change what is learned; the rest may differ when a training goes on.
_LEARNING = ("seed", "n_objects", "model", "train", "curriculum", "her", "augment")
_FREE = tuple(
    f"train.{key}"
    for key in (
        *("log_pushes", "checkpoint_minutes", "sdf_cache", "eval_pushes", "eval_episodes"),
        "env.scenario.max_tries",
    )
)


def train(
    config: Config,
    folder: Path,
    logger: Logger,
    build_network: BuildNetwork,
    keep_network: KeepNetwork = lambda network: None,
    evaluate: Evaluate | None = None,
) -> QNetwork:
    """Train a Q-network; where the folder holds a checkpoint, go on from it.

    Torch's own random state is left as it was.

    Args:
        config: The whole experiment.
        folder: The run folder; gets `train.csv` and the checkpoint.
        logger: Takes running figures.
        build_network: Makes the network before its first update.
        keep_network: Takes the network, as it is returned, with each checkpoint.
        evaluate: Plays held-out episodes every `train.eval_pushes`.

    Returns:
        The trained network, with the average of its weights over the last updates, on the CPU.

    Raises:
        SdfgcnError: The checkpoint is damaged or of another experiment.
    """
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage it makes
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

    The policy is there from the first checkpoint on; until the training has ended, its `budget`
    is null.

    Args:
        config: The whole experiment.
        folder: The run folder.
        policy: Where the policy goes.
        logger: Takes running figures.
        evaluate: Plays held-out episodes every `train.eval_pushes`.

    Raises:
        SdfgcnError: See `train`.
    """
    env = config.train.env
    load_catalogue(env.objects, env.split)  # before processes that push would each do it
    about = {"seed": config.seed, "training": learning_config(config)}

    def keep(network: QNetwork, budget: dict[str, Any] | None) -> None:
        save_policy(policy, network, {"budget": budget, **about})

    network = train(config, folder, logger, q_network, partial(keep, budget=None), evaluate)
    keep(network, asdict(config.budget))


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
    """Put the parts of a training together, as the folder's checkpoint left them; see `train`."""
    counts = ObjectCountSampler(config.curriculum, config.n_objects)
    env = training_env(config, counts)
    actions = PushSpace(env.push, env.arena).spec(env.max_objects)
    network = build_network(config, env.max_objects)
    state = TrainingState(
        Learner(network, actions, config.train, config.runtime.device),
        EpsilonGreedyPolicy(network, actions, config.train, config.budget.epsilon_pushes),
        Replay(config),
        Hindsight(config.her, env),
        Curriculum(config.curriculum, counts),
        Progress(folder, logger, config.train.log_pushes),
    )
    collector_state = _restored(state, folder / NAME, config)
    curve = HeldOutCurve(folder, logger, config.train.eval_pushes, evaluate)
    curve.go_on_from(state.progress.pushes)
    with torch.random.fork_rng():  # else a training that goes on would draw other numbers
        pushes = state.progress.pushes
        collector = build_collector(
            CollectorSpec(config, env, counts, state.policy.module, pushes, collector_state)
        )
    kept = learning_config(config)
    return Trainer(config, state, collector, curve, folder / NAME, kept, keep_network)


def _restored(state: TrainingState, checkpoint: Path, config: Config) -> dict[str, Any]:
    """Load the checkpoint, if there is one; returns the collector's state."""
    collector: dict[str, Any] = {}
    if checkpoint.exists():
        check_same_learning(checkpoint, config)
        load_checkpoint(checkpoint, state.parts(collector))
        state.policy.load_weights(state.learner.network)
        if not (collector and config.collector.name == "sync"):
            state.progress.forget_episode()
            state.hindsight.forget_episode()
    return collector


def training_env(config: Config, counts: ObjectCountSampler) -> EnvConfig:
    """The training env with as many rows as are needed, where the network allows any number.

    Args:
        config: The whole experiment.
        counts: The numbers of objects.
    """
    env, most = config.train.env, max(counts.counts)
    fixed = q_networks()[config.model.name].fixed_rows
    return replace(env, n_objects=most, max_objects=env.max_objects if fixed else most)


def learning_config(config: Config) -> dict[str, Any]:
    """What of a config changes what is learned, flat, as JSON knows it."""
    values = {part: value for part, value in asdict(config).items() if part in _LEARNING}
    return {key: value for key, value in flat(values).items() if not key.startswith(_FREE)}


def check_same_learning(path: Path, config: Config) -> None:
    """Check that a checkpoint belongs to a config.

    Raises:
        SdfgcnError: It does not; names the keys that differ.
    """
    told = differences(checkpoint_config(path), learning_config(config))
    if told:
        raise SdfgcnError(
            f"{path} is of another training, which differs in {told}; use the same values or "
            "another hydra.run.dir."
        )
