"""Collection of pushes for training (`collector=`): TorchRL's collectors around our env."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.queues import SimpleQueue
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
from sdfgcn.train.curriculum import ObjectCountSampler

IDLE_SECONDS = 0.2  # between checks whether the learner may update


class TrainingEnv(RearrangementEnv):
    """The env with the number of objects drawn at every reset."""

    def __init__(
        self,
        config: EnvConfig,
        counts: ObjectCountSampler,
        seed: int,
        state: dict[str, Any] | None = None,
    ) -> None:
        """Build the env.

        Args:
            config: The training env's config.
            counts: Draws the number of objects.
            seed: Seed from which episode seeds are drawn.
            state: A state from `save_state`, from which the first reset resumes.
        """
        self._counts = counts
        self._state = state
        super().__init__(config, seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        if self._state is not None:
            state, self._state = self._state, None
            return self.restore_state(state)
        self.n_objects = self._counts.draw(self._rng)
        return super()._reset(tensordict, **kwargs)


class WorkerEnv(TrainingEnv):
    """The env in a worker process, where TorchRL would drop the sentence of an error."""

    def __init__(
        self, config: EnvConfig, counts: ObjectCountSampler, seed: int, told: SimpleQueue[str]
    ) -> None:
        """Build the env; an error that the user can fix is put into `told`."""
        self._told = told
        super().__init__(config, counts, seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        with self._telling():
            return super()._reset(tensordict, **kwargs)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        with self._telling():
            return super()._step(tensordict)

    @contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except SdfgcnError as error:
            self._told.put(str(error))
            os._exit(1)  # without a traceback on stderr


class PushCollector(Protocol):
    """The interface between the trainer and a collector."""

    def collect(self, meanwhile: Callable[[], bool]) -> TensorDictBase:
        """Return the next pushes.

        Args:
            meanwhile: Called repeatedly while waiting for them; does some work and returns
                whether there was any.

        Returns:
            [T] transitions.

        Raises:
            SdfgcnError: A worker died, or its env raised it.
        """

    def update_policy_weights(self) -> None:
        """Push with the policy's current weights from now on."""

    def state(self) -> dict[str, Any]:
        """The state for a checkpoint, in JSON types."""

    def close(self) -> None:
        """Close the envs."""


@dataclass(frozen=True)
class CollectorSpec:
    """The arguments for building a collector.

    Attributes:
        config: The whole experiment.
        env: The training env's config.
        counts: Draws the number of objects.
        policy: Sets `action`; on the CPU.
        pushes: Pushes so far, so that a resumed training draws new episodes.
        state: The checkpoint's `PushCollector.state`, or empty.
    """

    config: Config
    env: EnvConfig
    counts: ObjectCountSampler
    policy: TensorDictModuleBase
    pushes: int
    state: Mapping[str, Any]


class SyncCollector:
    """One env in this process: pushes and updates alternate."""

    def __init__(self, spec: CollectorSpec) -> None:
        """Build the env."""
        seed = _seed(spec.config.seed, 0, 0)
        self._env = TrainingEnv(spec.env, spec.counts, seed, spec.state.get("env"))
        self._collector = Collector(
            self._env,
            spec.policy,
            frames_per_batch=spec.config.collector.pushes_per_batch,
            total_frames=-1,
            auto_register_policy_transforms=False,  # would add one for recurrent policies
        )
        self._batches = iter(self._collector)

    def collect(self, meanwhile: Callable[[], bool]) -> TensorDictBase:
        """Push; `meanwhile` is not called."""
        return next(self._batches)

    def update_policy_weights(self) -> None:
        """Do nothing: the collector uses the policy object itself."""

    def state(self) -> dict[str, Any]:
        """The env's state."""
        return {"env": self._env.save_state()}

    def close(self) -> None:
        """Close the env."""
        self._collector.shutdown()


class AsyncCollector:
    """Envs in worker processes, which push while this process learns."""

    def __init__(self, spec: CollectorSpec) -> None:
        """Start the workers."""
        config = spec.config
        workers = max(config.collector.workers, 1)
        seeds = [_seed(config.seed, worker, spec.pushes) for worker in range(workers)]
        self._told: SimpleQueue[str] = multiprocessing.get_context("spawn").SimpleQueue()
        with self._told_errors():
            self._collector = MultiAsyncCollector(
                [_env_in_worker] * workers,
                spec.policy,
                # As kwargs, not functools.partial: TorchRL would copy the shared memory of
                # `counts`.
                create_env_kwargs=[
                    {"config": spec.env, "counts": spec.counts, "seed": seed, "told": self._told}
                    for seed in seeds
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
        """Wait for the next pushes of any worker, calling `meanwhile`."""
        batch = self._waiter.submit(next, self._batches)
        while not batch.done():
            if not meanwhile():
                wait([batch], timeout=IDLE_SECONDS)
        try:
            with self._told_errors():
                return batch.result().clone()
        except RuntimeError as error:
            raise SdfgcnError(
                f"A process that pushes died ({str(error).partition(chr(10))[0]}); the same "
                "hydra.run.dir goes on from the last checkpoint."
            ) from error

    @contextmanager
    def _told_errors(self) -> Iterator[None]:
        """Raise what a worker told, where TorchRL only knows that it died."""
        try:
            yield
        except RuntimeError:
            if not self._told.empty():
                raise SdfgcnError(self._told.get()) from None
            raise

    def update_policy_weights(self) -> None:
        """Send the policy's weights."""
        self._collector.update_policy_weights_()

    def state(self) -> dict[str, Any]:
        """Empty: a resumed training starts new episodes."""
        return {}

    def close(self) -> None:
        """Stop the workers."""
        self._waiter.shutdown(wait=False)
        self._collector.shutdown()


def build_collector(spec: CollectorSpec) -> PushCollector:
    """Build the collector that the config names."""
    return (SyncCollector if spec.config.collector.name == "sync" else AsyncCollector)(spec)


def _env_in_worker(
    config: EnvConfig, counts: ObjectCountSampler, seed: int, told: SimpleQueue[str]
) -> WorkerEnv:
    torch.manual_seed(seed)  # the policy's random pushes
    return WorkerEnv(config, counts, seed, told)


def _seed(seed: int, worker: int, pushes: int) -> int:
    """The seed of a collector's env, distinct from those of evaluation episodes."""
    return int(np.random.SeedSequence(seed, spawn_key=(1, worker, pushes)).generate_state(1)[0])
