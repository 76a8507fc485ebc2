"""The training loop: push, remember, learn, tell, and keep a checkpoint."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, cast

import torch

from sdfgcn.agents.policy import save_policy
from sdfgcn.config import Config
from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.loggers import Logger
from sdfgcn.models import Q_NETWORKS, build_q_network
from sdfgcn.models.q_network import QNetwork
from sdfgcn.models.sdf_cnn import SdfCnn
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.train.actors import Actors, ActorsPlan, build_actors, training_env
from sdfgcn.train.checkpoint import NAME, checkpoint_config, load_checkpoint, save_checkpoint
from sdfgcn.train.curriculum import Counts, Curriculum
from sdfgcn.train.hindsight import Hindsight
from sdfgcn.train.learner import Explorer, Learner
from sdfgcn.train.progress import Progress
from sdfgcn.train.replay import build_replay, transitions

# Builds a network from the whole config and the number of slots that it is trained with.
BuildNetwork = Callable[[Config, int], QNetwork]
# Takes the network, on the CPU, whenever there is a new checkpoint.
KeepNetwork = Callable[[QNetwork], None]

# Parts of the config that change what is learned; the rest may differ when a training goes on.
_LEARNING = ("seed", "n_objects", "env", "model", "train", "curriculum", "her", "augment")
_FREE = {
    "env": ("split", "robot", "scenario.max_tries", "pushes_per_object"),
    "train": ("log_pushes", "checkpoint_minutes", "sdf_cache"),
}


def train(
    config: Config,
    folder: Path,
    logger: Logger,
    build_network: BuildNetwork,
    keep_network: KeepNetwork = lambda network: None,
) -> QNetwork:
    """Train a Q-network; where the folder holds a checkpoint, go on from it.

    Torch's own random state is left as it was.

    Args:
        config: The whole experiment.
        folder: The run folder; gets `train.csv` and the checkpoint.
        logger: Takes running figures.
        build_network: Makes the network before its first update.
        keep_network: Takes the network, as it is returned, with each checkpoint.

    Returns:
        The trained network, with the average of its weights over the last updates, on the CPU.

    Raises:
        SdfgcnError: The checkpoint is damaged or of another experiment, or the device is missing.
    """
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it tells of every storage it makes
    threads = torch.get_num_threads()
    with torch.random.fork_rng():
        torch.set_num_threads(config.runtime.torch_threads)
        torch.manual_seed(config.seed)
        try:
            with closing(Training(config, folder, logger, build_network, keep_network)) as training:
                training.run()
                return training.averaged
        finally:
            torch.set_num_threads(threads)


def train_policy(config: Config, folder: Path, policy: Path, logger: Logger) -> None:
    """Train the Q-network that the config names, and write it as a policy.

    The policy is there from the first checkpoint on; until the training has ended, its `budget`
    is null.

    Args:
        config: The whole experiment.
        folder: The run folder.
        policy: Where the policy goes.
        logger: Takes running figures.

    Raises:
        SdfgcnError: See `train`.
    """
    load_catalogue(config.env.objects, config.train.split)  # before actors would each do it
    slots = training_slots(config, Counts(config.curriculum, config.n_objects))
    about = {"seed": config.seed, "training": learning_config(config)}

    def keep(network: QNetwork, budget: dict[str, Any] | None) -> None:
        told = {"budget": budget, **about}
        save_policy(policy, network, config.model, slots, config.env.arena.image_size, told)

    network = train(config, folder, logger, q_network, partial(keep, budget=None))
    keep(network, asdict(config.budget))


def q_network(config: Config, max_objects: int) -> QNetwork:
    """The untrained network that the config names."""
    return build_q_network(config.model, max_objects, config.env.arena.image_size, config.seed)


class Training:
    """Everything that one training holds."""

    def __init__(
        self,
        config: Config,
        folder: Path,
        logger: Logger,
        build_network: BuildNetwork,
        keep_network: KeepNetwork,
    ) -> None:
        """Build all parts, and load the checkpoint if there is one; see `train`."""
        self._config = config
        self._checkpoint = folder / NAME
        self._keep_network = keep_network
        counts = Counts(config.curriculum, config.n_objects)
        slots = training_slots(config, counts)
        env = training_env(config, counts, slots)
        train = config.train
        self.network = build_network(config, slots)
        self._learner = Learner(self.network, slots, train, config.runtime.device)
        self._explorer = Explorer(self.network, slots, train, config.budget.epsilon_pushes)
        self._replay = build_replay(config)
        self._hindsight = Hindsight(config.her, env)
        self._counts = counts
        self._curriculum = Curriculum(config.curriculum, counts)
        self._progress = Progress(folder, logger, train.log_pushes)
        self._kept: dict[str, Any] = {}  # of the actors
        self._load()
        with torch.random.fork_rng():  # else a training that goes on would draw other numbers
            self._actors: Actors = build_actors(
                ActorsPlan(
                    config,
                    env,
                    counts,
                    self._explorer.policy,
                    self._progress.pushes,
                    dict(self._kept),
                )
            )
        self._saved = time.monotonic()

    def run(self) -> None:
        """Train to the end of the budget."""
        budget = self._config.budget
        self._progress.open(self._learner.updates, budget.pushes, budget.minutes)
        while not self._finished():
            self._push()
            self._learn()
            self._progress.tell(self._learner.updates, self._explorer.epsilon, self._counts.newest)
            if time.monotonic() - self._saved > 60.0 * self._config.train.checkpoint_minutes:
                self._save()
        self._save()

    @property
    def averaged(self) -> QNetwork:
        """The network with the average of its weights over the last updates, on the CPU."""
        return cast(QNetwork, self._learner.averaged)

    def close(self) -> None:
        """End the actors and the live line."""
        self._progress.close()
        self._actors.close()

    # ------------------------------------------------------------------ the loop's parts

    def _finished(self) -> bool:
        budget = self._config.budget
        late = budget.minutes is not None and self._progress.seconds > 60.0 * budget.minutes
        return late or self._progress.pushes >= budget.pushes

    def _push(self) -> None:
        """Take the next pushes into the replay buffer, and learn while they are made."""
        collected = self._actors.collect(meanwhile=self._update_within_limit)
        self._progress.pushed(collected)
        self._explorer.pushed(len(collected))
        outcome = collected["next"]
        for i in outcome["done"].squeeze(-1).nonzero().squeeze(-1).tolist():
            n_objects = int((collected["goal_position"][i] != 0.0).any(dim=-1).sum())
            self._curriculum.episode_ended(n_objects, bool(outcome["success"][i]))
        self._replay.extend(transitions(collected))
        relabelled = self._hindsight(collected)
        if relabelled is not None:
            self._replay.extend(transitions(relabelled))

    def _learn(self) -> None:
        """Do the updates that are due, and hand the weights to the actors."""
        while self._learner.updates < self._due(self._config.train.updates_per_push):
            self._update()
        self._explorer.follow(self.network)
        self._actors.publish()

    def _due(self, updates_per_push: float) -> int:
        train = self._config.train
        return int(updates_per_push * max(self._progress.pushes - train.learning_starts, 0))

    def _update_within_limit(self) -> bool:
        """Update if the actors' pushes allow another; return whether they do."""
        if self._learner.updates >= self._due(self._config.train.max_updates_per_push):
            return False
        self._update()
        return True

    def _update(self) -> None:
        batch = self._replay.sample()
        if self._learner.updates == 0:
            self._learner.choose_precision(self._config.runtime.precision, batch)
        self._progress.updated(self._learner.update(batch))

    # ------------------------------------------------------------------ checkpoints

    def _parts(self) -> dict[str, Any]:
        return {
            "learner": self._learner,
            "explorer": self._explorer,
            "replay": self._replay,
            "curriculum": self._curriculum,
            "progress": self._progress,
            "actors": self._kept,
        }

    def _save(self) -> None:
        self._kept.clear()
        self._kept.update(self._actors.state())
        save_checkpoint(self._checkpoint, self._parts(), learning_config(self._config))
        self._keep_network(self.averaged)
        self._saved = time.monotonic()

    def _load(self) -> None:
        if not self._checkpoint.exists():
            return
        check_same_learning(self._checkpoint, self._config)
        load_checkpoint(self._checkpoint, self._parts())
        self._explorer.follow(self.network)
        if not self._kept:
            self._progress.new_episodes()


def training_slots(config: Config, counts: Counts) -> int:
    """To how many objects observations are padded: no more than needed, where the model allows."""
    fixed = Q_NETWORKS[config.model.name] is SdfCnn
    return config.env.max_objects if fixed else max(counts.counts)


def learning_config(config: Config) -> dict[str, Any]:
    """What of a config changes what is learned, flat, as JSON knows it."""
    values = asdict(config)
    learning = flat({part: values[part] for part in _LEARNING})
    free = tuple(f"{part}.{key}" for part, keys in _FREE.items() for key in keys)
    return {key: value for key, value in learning.items() if not key.startswith(free)}


def check_same_learning(path: Path, config: Config) -> None:
    """Check that a checkpoint belongs to a config.

    Raises:
        SdfgcnError: It does not; names the keys that differ.
    """
    differing = differences(checkpoint_config(path), learning_config(config))
    if differing:
        raise SdfgcnError(
            f"{path} is of another training, which differs in {differing}; use the same values or "
            "another hydra.run.dir."
        )
