"""The training loop: push, remember, learn, tell, evaluate, and keep a checkpoint."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import torch
from tensordict import TensorDictBase

from sdfgcn.agents.policy import save_policy
from sdfgcn.config import Config, EnvConfig
from sdfgcn.config.diff import differences, flat
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import write_json
from sdfgcn.loggers import Logger
from sdfgcn.models import build_q_network, q_networks
from sdfgcn.models.q_network import QNetwork
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.task.push_space import PushSpace
from sdfgcn.train.checkpoint import NAME, checkpoint_config, load_checkpoint, save_checkpoint
from sdfgcn.train.collectors import CollectorSpec, build_collector
from sdfgcn.train.curriculum import Curriculum, ObjectCountSampler
from sdfgcn.train.exploration import EpsilonGreedyPolicy
from sdfgcn.train.held_out import Evaluate, HeldOutCurve
from sdfgcn.train.hindsight import Hindsight
from sdfgcn.train.learner import Learner
from sdfgcn.train.progress import Progress
from sdfgcn.train.replay import Replay

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
            curve = HeldOutCurve(folder, logger, config.train.eval_pushes, evaluate)
            with closing(
                Trainer(config, folder, logger, build_network, keep_network, curve)
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


class Trainer:
    """Everything that one training holds, and its loop."""

    def __init__(
        self,
        config: Config,
        folder: Path,
        logger: Logger,
        build_network: BuildNetwork,
        keep_network: KeepNetwork,
        curve: HeldOutCurve,
    ) -> None:
        """Build all parts, and load the checkpoint if there is one; see `train`."""
        self._config, self._folder = config, folder
        self._keep_network = keep_network
        counts = ObjectCountSampler(config.curriculum, config.n_objects)
        env = training_env(config, counts)
        actions = PushSpace(env.push, env.arena).spec(env.max_objects)
        self.network = build_network(config, env.max_objects)
        self._learner = Learner(self.network, actions, config.train, config.runtime.device)
        self._policy = EpsilonGreedyPolicy(
            self.network, actions, config.train, config.budget.epsilon_pushes
        )
        self._replay = Replay(config)
        self._hindsight = Hindsight(config.her, env)
        self._curriculum = Curriculum(config.curriculum, counts)
        self._progress = Progress(folder, logger, config.train.log_pushes)
        self._curve = curve
        self._collector_state: dict[str, Any] = {}
        self._load()
        with torch.random.fork_rng():  # else a training that goes on would draw other numbers
            self._collector = build_collector(
                CollectorSpec(
                    config,
                    env,
                    counts,
                    self._policy.module,
                    self._progress.pushes,
                    dict(self._collector_state),
                )
            )
        self._saved = time.monotonic()

    def run(self) -> None:
        """Train to the end of the budget."""
        budget = self._config.budget
        self._progress.open(self._learner.updates, budget.pushes, budget.minutes)
        while not self._finished():
            collected = self._collector.collect(meanwhile=self._update_within_limit)
            self._remember(collected)
            self._learn()
            self._progress.tell(
                self._learner.updates, self._policy.epsilon, self._curriculum.newest
            )
            self._curve.pushed(self._progress.pushes, lambda: self.averaged)
            if time.monotonic() - self._saved > 60.0 * self._config.train.checkpoint_minutes:
                self._save()
        self._save()

    @property
    def averaged(self) -> QNetwork:
        """The network with the average of its weights over the last updates, on the CPU."""
        return cast(QNetwork, self._learner.averaged)

    def close(self) -> None:
        """End the collector and the live line."""
        self._progress.close()
        self._collector.close()

    # ------------------------------------------------------------------ the loop's parts

    def _finished(self) -> bool:
        budget = self._config.budget
        late = budget.minutes is not None and self._progress.seconds > 60.0 * budget.minutes
        return late or self._progress.pushes >= budget.pushes

    def _remember(self, collected: TensorDictBase) -> None:
        """Take [T] pushes into the replay buffer, once as they were and once in hindsight."""
        self._progress.pushed(collected)
        self._policy.pushed(len(collected))
        self._curriculum.pushed(collected)
        transitions = self._replay.stored(collected)
        self._replay.extend(transitions)
        self._replay.extend(self._hindsight(transitions, collected["collector", "traj_ids"]))

    def _learn(self) -> None:
        """Do the updates that are due, and hand the weights to the collector."""
        while self._learner.updates < self._due(self._config.train.utd_ratio):
            self._update()
        self._policy.load_weights(self.network)
        self._collector.update_policy_weights()

    def _due(self, utd_ratio: float) -> int:
        late = self._progress.pushes - self._config.train.learning_starts
        return int(utd_ratio * max(late, 0))

    def _update_within_limit(self) -> bool:
        """Update if the pushes so far allow another; return whether they do."""
        if self._learner.updates >= self._due(self._config.train.max_utd_ratio):
            return False
        self._update()
        return True

    def _update(self) -> None:
        batch = self._replay.sample()
        if self._learner.precision is None:
            self._choose_precision(batch)
        self._progress.updated(self._learner.update(batch))

    def _choose_precision(self, batch: TensorDictBase) -> None:
        """Choose it once a run folder: what is faster today may not be tomorrow."""
        wanted, kept = self._config.runtime.precision, self._folder / "precision.json"
        if wanted == "auto" and kept.exists():
            wanted = json.loads(kept.read_text(encoding="utf-8"))["precision"]
        chosen = self._learner.choose_precision(wanted, batch)
        if self._config.runtime.precision == "auto":
            write_json(kept, {"precision": chosen})

    # ------------------------------------------------------------------ checkpoints

    def _parts(self) -> dict[str, Any]:
        return {
            "learner": self._learner,
            "policy": self._policy,
            "replay": self._replay.buffer,
            "hindsight": self._hindsight,
            "curriculum": self._curriculum,
            "progress": self._progress,
            "collector": self._collector_state,
        }

    def _save(self) -> None:
        self._collector_state.clear()
        self._collector_state.update(self._collector.state())
        save_checkpoint(self._folder / NAME, self._parts(), learning_config(self._config))
        self._keep_network(self.averaged)
        self._saved = time.monotonic()

    def _load(self) -> None:
        if (self._folder / NAME).exists():
            check_same_learning(self._folder / NAME, self._config)
            load_checkpoint(self._folder / NAME, self._parts())
            self._policy.load_weights(self.network)
            if not self._collector_state:
                self._progress.forget_episode()
                self._hindsight.forget_episode()
        self._curve.go_on_from(self._progress.pushes)


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
