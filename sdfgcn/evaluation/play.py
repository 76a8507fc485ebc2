"""Playing one episode: an agent picks pushes in an environment until it ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from sdfgcn.evaluation.episodes import EpisodeResult

# What loads torch is imported where it is used: the main process of parallel workers needs none.
if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor

    from sdfgcn.envs.records import EpisodeStart, StepRecord

# Sets `action` on an observation, and `action_value` if a Q-network picked it.
Policy = Callable[["TensorDictBase"], "TensorDictBase"]


class Env(Protocol):
    """What an evaluation needs of an environment (sdfgcn/envs)."""

    record: bool
    episode_start: EpisodeStart
    last_step: StepRecord

    def reset_episode(self, seed: int) -> TensorDictBase:
        """Begin the episode that the seed and the config define."""

    def step(self, td: TensorDictBase) -> TensorDictBase:
        """Execute `td["action"]`; what follows stands under "next"."""

    def close(self) -> Any:
        """Free the simulation."""


class Recorder(Protocol):
    """What an evaluation needs of a recorder (sdfgcn/viz)."""

    def start(self, episode: EpisodeStart) -> None:
        """Take the start of an episode."""

    def step(self, step: StepRecord) -> None:
        """Take one push."""


class EpisodeStoppedError(Exception):
    """The run ended while this episode was being played."""


def episode_seeds(seed: int, episode: int) -> tuple[int, np.random.Generator]:
    """Derive one episode's randomness from the evaluation's seed.

    Args:
        seed: The evaluation's seed.
        episode: The episode's index, from 0.

    Returns:
        The environment's seed, below 2**32, and the agent's generator.
    """
    for_env, for_agent = np.random.SeedSequence(seed, spawn_key=(episode,)).spawn(2)
    return int(for_env.generate_state(1)[0]), np.random.default_rng(for_agent)


def play_episode(
    env: Env,
    policy: Policy,
    episode: int,
    seed: int,
    recorder: Recorder | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> EpisodeResult:
    """Play one episode to its end.

    Args:
        env: Where.
        policy: Who picks the pushes.
        episode: Its index in the evaluation.
        seed: Its seed.
        recorder: Takes the start and every push, if given.
        stopped: Asked before each push; the episode is given up when it says so.

    Raises:
        EpisodeStoppedError: `stopped` said so.
    """
    clock = time.monotonic()
    env.record = recorder is not None
    td = env.reset_episode(seed)
    if recorder is not None:
        recorder.start(env.episode_start)
    total_reward, done = 0.0, False
    while not done:
        if stopped():
            raise EpisodeStoppedError
        chosen = policy(td)
        values = chosen.get("action_value", None)
        td = env.step(chosen)["next"]
        total_reward += float(td["reward"])
        done = bool(td["done"])
        if recorder is not None:
            recorder.step(_with_values(env.last_step, values))
    last, start = env.last_step, env.episode_start
    objects = () if start.truth is None else start.truth.objects
    known = last.distances[np.isfinite(last.distances)]  # none where nothing is matched any more
    return EpisodeResult(
        episode=episode,
        seed=seed,
        n_objects=start.n_objects,
        objects=";".join(model.name for model in objects),
        success=bool(last.success),
        pushes=last.index,
        error_mm=round(1000 * float(known.mean()), 3) if len(known) else math.nan,
        out_of_range=bool(last.out_of_range),
        truncated=bool(last.truncated),
        return_=round(total_reward, 6),
        wall_s=round(time.monotonic() - clock, 3),
    )


def _with_values(step: StepRecord, values: Tensor | None) -> StepRecord:
    """The step with the agent's action values, [N * D], if it has any."""
    if values is None:
        return step
    return replace(step, q_values=values.numpy().reshape(step.legal.shape))
