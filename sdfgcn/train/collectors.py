"""Who pushes while a Q-network learns (`collector=`): TorchRL's collectors around our env."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
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

IDLE_SECONDS = 0.2  # between two looks at whether the learner may do an update


class TrainingEnv(RearrangementEnv):
    """The env with a number of objects drawn anew at every reset."""

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
            seed: Seed of the episodes' seeds.
            state: What `save_state` returned: the first reset goes on from there.
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


class PushCollector(Protocol):
    """What a training needs of whoever pushes."""

    def collect(self, meanwhile: Callable[[], bool]) -> TensorDictBase:
        """The next pushes.

        Args:
            meanwhile: Work to do while they are being collected, if there is time; returns
                whether there was any.

        Returns:
            [T] transitions.

        Raises:
            SdfgcnError: A process that pushes died.
        """

    def update_policy_weights(self) -> None:
        """Push with the policy's weights of now."""

    def state(self) -> dict[str, Any]:
        """What a checkpoint keeps, as JSON knows it."""

    def close(self) -> None:
        """Free the envs."""


@dataclass(frozen=True)
class CollectorSpec:
    """What a collector is made of.

    Attributes:
        config: The whole experiment.
        env: The training env's config.
        counts: Draws the number of objects.
        policy: Sets `action`; on the CPU.
        pushes: Pushes so far; a training that goes on draws other episodes.
        state: What `PushCollector.state` returned.
    """

    config: Config
    env: EnvConfig
    counts: ObjectCountSampler
    policy: TensorDictModuleBase
    pushes: int
    state: Mapping[str, Any]


class SyncCollector:
    """One env in this process: pushes and updates take turns."""

    def __init__(self, spec: CollectorSpec) -> None:
        """Build the env."""
        seed = _seed(spec.config.seed, 0, 0)
        self._env = TrainingEnv(spec.env, spec.counts, seed, spec.state.get("env"))
        self._collector = Collector(
            self._env,
            spec.policy,
            frames_per_batch=spec.config.collector.pushes_per_batch,
            total_frames=-1,
            auto_register_policy_transforms=False,  # it would add one for recurrent policies
        )
        self._batches = iter(self._collector)

    def collect(self, meanwhile: Callable[[], bool]) -> TensorDictBase:
        """Push; there is no meanwhile."""
        return next(self._batches)

    def update_policy_weights(self) -> None:
        """Do nothing: it pushes with the policy itself."""

    def state(self) -> dict[str, Any]:
        """The env's state."""
        return {"env": self._env.save_state()}

    def close(self) -> None:
        """Free the env."""
        self._collector.shutdown()


class AsyncCollector:
    """Envs in processes of their own, which push while this one learns."""

    def __init__(self, spec: CollectorSpec) -> None:
        """Start the processes."""
        config = spec.config
        workers = max(config.collector.workers, 1)
        seeds = [_seed(config.seed, worker, spec.pushes) for worker in range(workers)]
        self._collector = MultiAsyncCollector(
            [_env_in_worker] * workers,
            spec.policy,
            # Not bound to the function: TorchRL would copy what of `counts` is shared.
            create_env_kwargs=[
                {"config": spec.env, "counts": spec.counts, "seed": seed} for seed in seeds
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
        """Wait for the next pushes of any process, working meanwhile."""
        batch = self._waiter.submit(next, self._batches)
        while not batch.done():
            if not meanwhile():
                wait([batch], timeout=IDLE_SECONDS)
        try:
            return batch.result().clone()
        except RuntimeError as error:
            raise SdfgcnError(
                f"A process that pushes died ({str(error).partition(chr(10))[0]}); the same "
                "hydra.run.dir goes on from the last checkpoint."
            ) from error

    def update_policy_weights(self) -> None:
        """Send the policy's weights."""
        self._collector.update_policy_weights_()

    def state(self) -> dict[str, Any]:
        """Nothing: a training that goes on begins new episodes."""
        return {}

    def close(self) -> None:
        """End the processes."""
        self._waiter.shutdown(wait=False)
        self._collector.shutdown()


def build_collector(spec: CollectorSpec) -> PushCollector:
    """Build the collector that the config names."""
    return (SyncCollector if spec.config.collector.name == "sync" else AsyncCollector)(spec)


def _env_in_worker(config: EnvConfig, counts: ObjectCountSampler, seed: int) -> TrainingEnv:
    torch.manual_seed(seed)  # the policy's random pushes
    return TrainingEnv(config, counts, seed)


def _seed(seed: int, worker: int, pushes: int) -> int:
    """The seed of a collector's env, other than those of evaluation episodes."""
    return int(np.random.SeedSequence(seed, spawn_key=(1, worker, pushes)).generate_state(1)[0])
