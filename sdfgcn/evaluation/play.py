"""Playing one episode: an agent picks pushes in an environment until it ends."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.episodes import EpisodeResult

# Modules that load torch are imported where used: a main process with workers needs none.
if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor

    from sdfgcn.envs.records import EpisodeStart, StepRecord
    from sdfgcn.task.explanation import Explanation

# Sets `action` in an observation, and `action_value` if a Q-network chose it. It may also have a
# method `explain`, which takes the result and returns an `Explanation` or None; it is called only
# in recorded episodes.
Policy = Callable[["TensorDictBase"], "TensorDictBase"]


class Env(Protocol):
    """The part of an environment (sdfgcn/envs) that an evaluation uses."""

    record: bool
    episode_start: EpisodeStart
    last_step: StepRecord

    def reset_episode(self, seed: int) -> TensorDictBase:
        """Start the episode determined by the seed and the config."""

    def step(self, td: TensorDictBase) -> TensorDictBase:
        """Execute `td["action"]`; the result is under "next"."""

    def close(self) -> Any:
        """Free the simulation."""


class Recorder(Protocol):
    """The part of a recorder (sdfgcn/viz) that an evaluation uses."""

    def start(self, episode: EpisodeStart) -> None:
        """Record the start of an episode."""

    def step(self, step: StepRecord) -> None:
        """Record one push."""


class EpisodeStoppedError(Exception):
    """The run was stopped during this episode."""


def episode_seeds(seed: int, episode: int) -> tuple[int, np.random.Generator]:
    """Derive an episode's randomness from the evaluation's seed.

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
        env: The environment.
        policy: Chooses the pushes.
        episode: The episode's index in the evaluation.
        seed: The episode's seed.
        recorder: Records the start and every push, if given.
        stopped: Called before each push; the episode is abandoned when it returns True.

    Raises:
        EpisodeStoppedError: `stopped` returned True.
        SdfgcnError: A legal push has a Q-value that is not finite, or the env raised it.
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
        if values is not None and not values[chosen["action_mask"]].isfinite().all():
            raise SdfgcnError(
                f"The Q-values of push {int(chosen['pushes']) + 1} in episode {episode} (seed "
                f"{seed}) are not finite: the weights are damaged or their training diverged; use "
                "another checkpoint, or train with a lower train.learning_rate."
            )
        explanation = None if recorder is None else _explanation(policy, chosen)
        td = env.step(chosen)["next"]
        total_reward += float(td["reward"])
        done = bool(td["done"])
        if recorder is not None:
            recorder.step(_thoughtful(env.last_step, values, explanation))
    last, start = env.last_step, env.episode_start
    objects = () if start.truth is None else start.truth.objects
    known = last.distances[np.isfinite(last.distances)]  # empty if no object is matched any more
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


def _explanation(policy: Policy, chosen: TensorDictBase) -> Explanation | None:
    """What the policy expects of the push that it chose; None if it does not say."""
    explain = getattr(policy, "explain", None)
    return None if explain is None else explain(chosen)


def _thoughtful(
    step: StepRecord, values: Tensor | None, explanation: Explanation | None
) -> StepRecord:
    """The step with the agent's action values, [N * D], and its explanation, if there are any."""
    q_values = None if values is None else values.numpy().reshape(step.legal.shape)
    return replace(step, q_values=q_values, explanation=explanation)
