"""Playing evaluation episodes, in this process or in parallel ones.

Every episode has its own seed, drawn from `eval.seed` and the episode's index, and its own
generator for the agent. So its result does not depend on which process plays it, or when.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from tqdm import tqdm

from sdfgcn.config import Config, EnvConfig
from sdfgcn.episodes import EpisodeResult
from sdfgcn.errors import SdfgcnError
from sdfgcn.loggers import Logger
from sdfgcn.processes import follow_parent

# What loads torch is imported where it is used: the main process of parallel workers needs none.
if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor

    from sdfgcn.agents.epsilon_greedy import EpsilonGreedy
    from sdfgcn.envs.records import EpisodeStart, StepRecord


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


MakeEnv = Callable[[EnvConfig], Env]
MakeRecorder = Callable[[Path, EnvConfig], AbstractContextManager[Recorder]]


def make_rearrangement(env: EnvConfig) -> Env:
    """Build the environment of `conf/env/`."""
    from sdfgcn.envs.rearrangement import RearrangementEnv

    return RearrangementEnv(env)


@dataclass(frozen=True)
class Evaluation:
    """What to play: picklable, so that a worker process can be given it.

    Attributes:
        config: The whole experiment.
        recordings: Folder for the recordings of the first `config.viz.episodes` episodes.
        make_recorder: Builds the recorder of an episode, given the file to write.
        make_env: Builds the environment; called once a process.
    """

    config: Config
    recordings: Path
    make_recorder: MakeRecorder
    make_env: MakeEnv = make_rearrangement


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


def evaluate(evaluation: Evaluation, finished: Iterable[int] = ()) -> Iterator[EpisodeResult]:
    """Play the episodes of an evaluation that are not finished yet.

    Args:
        evaluation: What to play.
        finished: Indices of episodes to leave out.

    Yields:
        Each episode when it ends; with workers, in the order in which they end.

    Raises:
        SdfgcnError: A layout cannot be placed, or a worker process died.
    """
    config = evaluation.config
    missing = sorted(set(range(config.eval.episodes)).difference(finished))
    if config.runtime.workers == 0 or not missing:
        yield from _in_this_process(evaluation, missing)
    else:
        yield from _in_workers(evaluation, missing)


def watch(
    episodes: Iterable[EpisodeResult], finished: Sequence[EpisodeResult], total: int, logger: Logger
) -> Iterator[EpisodeResult]:
    """Pass episodes on, with a progress bar and running figures.

    The bar shows the time left and the success rate so far. It is on stderr, and only on a
    terminal.

    Args:
        episodes: The episodes as they end.
        finished: Those that were there before.
        total: How many the evaluation has.
        logger: Takes the figures; its step is the number of episodes that have ended.
    """
    successes = sum(episode.success for episode in finished)
    with tqdm(total=total, initial=len(finished), unit="episode", disable=None) as bar:
        for played, episode in enumerate(episodes, start=len(finished) + 1):
            successes += episode.success
            figures = {
                "success": float(episode.success),
                "success_rate": successes / played,
                "pushes": float(episode.pushes),
                "error_mm": episode.error_mm,
                "return": episode.return_,
            }
            logger.log(played, figures)
            bar.set_postfix_str(f"success {successes / played:.0%}", refresh=False)
            bar.update()
            yield episode


def play_episode(
    env: Env,
    agent: EpsilonGreedy,
    episode: int,
    seed: int,
    recorder: Recorder | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> EpisodeResult:
    """Play one episode to its end.

    Args:
        env: Where.
        agent: Who picks the pushes.
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
        chosen = agent(td)
        values = chosen.get("action_value", None)
        td = env.step(chosen)["next"]
        total_reward += float(td["reward"])
        done = bool(td["done"])
        if recorder is not None:
            recorder.step(_with_values(env.last_step, values))
    last, start = env.last_step, env.episode_start
    objects = () if start.truth is None else start.truth.objects
    return EpisodeResult(
        episode=episode,
        seed=seed,
        n_objects=start.n_objects,
        objects=";".join(model.name for model in objects),
        success=bool(last.success),
        pushes=last.index,
        error_mm=round(1000 * float(np.nanmean(last.distances)), 3),
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


class _Player:
    """Plays episodes of one evaluation in one environment, built when first needed."""

    def __init__(self, evaluation: Evaluation, stopped: Callable[[], bool]) -> None:
        self._evaluation = evaluation
        self._stopped = stopped
        self._env: Env | None = None

    def play(self, episode: int) -> EpisodeResult:
        config = self._evaluation.config
        if self._env is None:
            self._env = self._build_env()
        from sdfgcn.agents import build_agent

        seed, rng = episode_seeds(config.eval.seed, episode)
        with self._recorder(episode) as recorder:
            agent = build_agent(config, rng)
            return play_episode(self._env, agent, episode, seed, recorder, self._stopped)

    def _build_env(self) -> Env:
        config = self._evaluation.config
        env = self._evaluation.make_env(config.env)
        import torch

        torch.set_num_threads(config.runtime.torch_threads)
        return env

    def _recorder(self, episode: int) -> AbstractContextManager[Recorder | None]:
        evaluation = self._evaluation
        if episode >= evaluation.config.viz.episodes:
            return nullcontext()
        path = evaluation.recordings / f"episode_{episode:03d}.rrd"
        return evaluation.make_recorder(path, evaluation.config.env)

    def close(self) -> None:
        if self._env is not None:
            self._env.close()


def _in_this_process(evaluation: Evaluation, episodes: Sequence[int]) -> Iterator[EpisodeResult]:
    player = _Player(evaluation, stopped=lambda: False)
    try:
        for episode in episodes:
            yield player.play(episode)
    finally:
        player.close()


def _in_workers(evaluation: Evaluation, episodes: Sequence[int]) -> Iterator[EpisodeResult]:
    if multiprocessing.get_start_method() not in multiprocessing.get_all_start_methods():
        # A process of joblib's launcher: its own start method is unknown to processes spawned here.
        multiprocessing.set_start_method("spawn", force=True)
    context = multiprocessing.get_context("spawn")  # a forked OpenGL context does not work
    stop = context.Event()
    workers = min(evaluation.config.runtime.workers, len(episodes))
    pool = ProcessPoolExecutor(workers, context, _start_worker, (evaluation, stop))
    try:
        yield from _as_they_end([pool.submit(_play_in_worker, episode) for episode in episodes])
    finally:
        stop.set()
        pool.shutdown(cancel_futures=True)


def _as_they_end(futures: Sequence[Future[EpisodeResult]]) -> Iterator[EpisodeResult]:
    try:
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool as error:
        raise SdfgcnError(
            "A worker process died (often for want of memory: try fewer runtime.workers); the "
            "episodes so far are kept, and the same hydra.run.dir goes on from them."
        ) from error


_player: _Player | None = None  # the worker process's own


def _start_worker(evaluation: Evaluation, stop: Event) -> None:
    global _player
    follow_parent()  # on Ctrl-C it sets `stop`
    atexit.register(os._exit, 0)  # freeing torch and OpenGL at the end takes two seconds
    _player = _Player(evaluation, stopped=stop.is_set)


def _play_in_worker(episode: int) -> EpisodeResult:
    assert _player is not None
    return _player.play(episode)
