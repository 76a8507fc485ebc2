"""Who pushes while a Q-network learns (`collector=`): TorchRL's collectors around our env."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.collectors import Collector, MultiAsyncCollector

from sdfgcn.config import Config, EnvConfig
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError
from sdfgcn.processes import follow_parent
from sdfgcn.sim.episode import Episode
from sdfgcn.train.curriculum import Counts

IDLE_SECONDS = 0.2  # between two looks at whether the learner may do an update


class TrainingEnv(RearrangementEnv):
    """The env with a number of objects drawn anew at every reset."""

    def __init__(
        self, config: EnvConfig, counts: Counts, seed: int, state: Mapping[str, Any] | None = None
    ) -> None:
        """Build the env.

        Args:
            config: The env's config.
            counts: Draws the number of objects.
            seed: Seed of the episodes' seeds.
            state: What `packed_state` returned: the first reset goes on from there.
        """
        self._counts = counts
        self._state = None if state is None else _unpacked_state(state)
        super().__init__(config, seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        if self._state is not None:
            state, self._state = self._state, None
            return self.restore_state(state)
        self.n_objects = self._counts.draw(self._rng)
        return super()._reset(tensordict, **kwargs)

    def packed_state(self) -> dict[str, Any]:
        """All that later pushes depend on, as JSON knows it."""
        state = self.save_state()
        episode = {
            key: value.tolist() if isinstance(value, np.ndarray) else value
            for key, value in asdict(state["episode"]).items()
        }
        return {**state, "episode": episode, "poses": state["poses"].tolist()}


def _unpacked_state(state: Mapping[str, Any]) -> dict[str, Any]:
    episode: dict[str, Any] = {
        key: np.array(value) if isinstance(value, list) else value
        for key, value in state["episode"].items()
    }
    return {**state, "episode": Episode(**episode), "poses": np.array(state["poses"])}


class Actors(Protocol):
    """What the learner needs of those who push."""

    def collect(self, meanwhile: Callable[[], bool]) -> TensorDictBase:
        """The next pushes.

        Args:
            meanwhile: Work to do while they are being collected, if there is time; returns
                whether there was any.

        Returns:
            [T] transitions.

        Raises:
            SdfgcnError: An actor's process died.
        """

    def publish(self) -> None:
        """Let the actors push with the policy's weights of now."""

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps of them, as JSON knows it."""

    def close(self) -> None:
        """End them."""


@dataclass(frozen=True)
class ActorsPlan:
    """What actors are made of.

    Attributes:
        config: The whole experiment.
        env: The training env's part of it.
        counts: Draws the number of objects.
        policy: Sets `action`; on the CPU.
        pushes: Pushes so far; actors of a later start draw other episodes.
        state: What `Actors.state` returned.
    """

    config: Config
    env: EnvConfig
    counts: Counts
    policy: TensorDictModuleBase
    pushes: int
    state: Mapping[str, Any]


class SyncActors:
    """One env in this process."""

    def __init__(self, plan: ActorsPlan) -> None:
        """Build the env."""
        seed = _seed(plan.config.seed, 0, 0)
        self._env = TrainingEnv(plan.env, plan.counts, seed, plan.state.get("env"))
        self._collector = Collector(
            self._env,
            plan.policy,
            frames_per_batch=plan.config.collector.pushes_per_batch,
            total_frames=-1,
            auto_register_policy_transforms=False,  # it would add one for recurrent policies
        )
        self._batches = iter(self._collector)

    def collect(self, meanwhile: Callable[[], bool]) -> TensorDictBase:
        """Push; there is no meanwhile."""
        return next(self._batches)

    def publish(self) -> None:
        """Do nothing: the collector pushes with the policy itself."""

    def state(self) -> dict[str, Any]:
        """The env's state."""
        return {"env": self._env.packed_state()}

    def close(self) -> None:
        """Free the env."""
        self._collector.shutdown()


class AsyncActors:
    """Envs in processes of their own, which push while this one learns."""

    def __init__(self, plan: ActorsPlan) -> None:
        """Start the processes."""
        config = plan.config
        workers = config.collector.workers
        seeds = [_seed(config.seed, worker, plan.pushes) for worker in range(workers)]
        self._collector = MultiAsyncCollector(
            [_env_in_worker] * workers,
            plan.policy,
            # Not bound to the function: TorchRL would copy what of `counts` is shared.
            create_env_kwargs=[
                {"config": plan.env, "counts": plan.counts, "seed": seed} for seed in seeds
            ],
            frames_per_batch=config.collector.pushes_per_batch,
            total_frames=-1,
            num_threads=torch.get_num_threads(),
            num_sub_threads=config.runtime.torch_threads,
            auto_register_policy_transforms=False,
            init_fn=follow_parent,
        )
        self._batches = iter(self._collector)
        self._waiter = ThreadPoolExecutor(1)

    def collect(self, meanwhile: Callable[[], bool]) -> TensorDictBase:
        """Wait for the next pushes of any actor, working meanwhile."""
        batch = self._waiter.submit(next, self._batches)
        while not batch.done():
            if not meanwhile():
                wait([batch], timeout=IDLE_SECONDS)
        try:
            return batch.result().clone()
        except RuntimeError as error:
            raise SdfgcnError(
                f"An actor's process died ({str(error).partition(chr(10))[0]}); the same "
                "hydra.run.dir goes on from the last checkpoint."
            ) from error

    def publish(self) -> None:
        """Send the policy's weights."""
        self._collector.update_policy_weights_()

    def state(self) -> dict[str, Any]:
        """Nothing: the actors begin new episodes."""
        return {}

    def close(self) -> None:
        """End the processes."""
        self._waiter.shutdown(wait=False)
        self._collector.shutdown()


def build_actors(plan: ActorsPlan) -> Actors:
    """Start those who push."""
    return (SyncActors if plan.config.collector.name == "sync" else AsyncActors)(plan)


def training_env(config: Config, counts: Counts, max_objects: int) -> EnvConfig:
    """The env's config as it is trained in.

    Args:
        config: The whole experiment.
        counts: The numbers of objects.
        max_objects: Slots that observations are padded to.
    """
    return replace(config.train.env, n_objects=max(counts.counts), max_objects=max_objects)


def _env_in_worker(config: EnvConfig, counts: Counts, seed: int) -> TrainingEnv:
    torch.manual_seed(seed)  # the policy's random pushes
    return TrainingEnv(config, counts, seed)


def _seed(seed: int, worker: int, pushes: int) -> int:
    """An actor's seed, other than those of evaluation episodes."""
    return int(np.random.SeedSequence(seed, spawn_key=(1, worker, pushes)).generate_state(1)[0])
