"""Playing evaluation episodes, in this process or in parallel workers.

Every episode has its own seed and agent generator, derived from `eval.seed` and the episode's
index, so its result does not depend on which process plays it, or when.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sdfgcn.config import Config, EnvConfig, VizConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.episodes import EpisodeResult
from sdfgcn.evaluation.play import Env, Recorder, episode_seeds, play_episode
from sdfgcn.loggers import Logger
from sdfgcn.processes import follow_parent
from sdfgcn.progress_bar import progress_bar

# Modules that load torch are imported where used: a main process with workers needs none.
if TYPE_CHECKING:
    from sdfgcn.models.q_network import QNetwork

MakeEnv = Callable[[EnvConfig], Env]
MakeRecorder = Callable[[Path, EnvConfig, VizConfig], AbstractContextManager[Recorder]]


def make_rearrangement(env: EnvConfig) -> Env:
    """Build the environment of `conf/env/`."""
    from sdfgcn.envs.rearrangement import RearrangementEnv

    return RearrangementEnv(env)


@dataclass(frozen=True)
class Evaluation:
    """What to play; picklable, so that it can be sent to workers.

    Attributes:
        config: The whole config.
        recordings: Folder for the recordings of the first `config.viz.episodes` episodes.
        make_recorder: Builds an episode's recorder, given the file to write without its suffix.
        make_env: Builds the environment; called once per process.
    """

    config: Config
    recordings: Path
    make_recorder: MakeRecorder
    make_env: MakeEnv = make_rearrangement


def evaluate(evaluation: Evaluation, finished: Iterable[int] = ()) -> Iterator[EpisodeResult]:
    """Play the unfinished episodes of an evaluation.

    Args:
        evaluation: What to play.
        finished: Indices of episodes to skip.

    Yields:
        Each episode as it ends; with workers, in order of completion.

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
    """Yield episodes unchanged, with a progress bar and running metrics.

    The bar shows the time left and the success rate so far, on stderr.

    Args:
        episodes: The episodes as they end.
        finished: The episodes from before.
        total: Number of episodes in the evaluation.
        logger: Receives the metrics; the step is the number of finished episodes.
    """
    successes = sum(episode.success for episode in finished)
    with progress_bar(total=total, initial=len(finished), unit="episode") as bar:
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


class HeldOutEvaluation:
    """Greedy evaluation of a network during training, on the evaluation's first scenes."""

    def __init__(self, config: Config, make_env: MakeEnv = make_rearrangement) -> None:
        """Set up the evaluation; the environment is built at the first call.

        Args:
            config: The whole config; `eval.seed`, `train.eval_episodes` and `env` are used.
            make_env: Builds the environment of `env`.
        """
        self._config = config
        self._make_env = make_env
        self._env: Env | None = None

    def __call__(self, network: QNetwork) -> dict[str, float]:
        """Play the episodes.

        Returns:
            `episodes`, `success_rate`, `episode_pushes`, `error_mm` and `out_of_range_rate`: means
            over all episodes.
        """
        from sdfgcn.agents.epsilon_greedy import EpsilonGreedy, QAgent

        if self._env is None:
            self._env = self._make_env(self._config.env)
        played = []
        for episode in range(self._config.train.eval_episodes):
            seed, rng = episode_seeds(self._config.eval.seed, episode)
            agent = EpsilonGreedy(QAgent(network), rng, epsilon=0.0, loop_distance=None)
            played.append(play_episode(self._env, agent, episode, seed))
        return {
            "episodes": float(len(played)),
            "success_rate": float(np.mean([result.success for result in played])),
            "episode_pushes": float(np.mean([result.pushes for result in played])),
            "error_mm": float(np.mean([result.error_mm for result in played])),
            "out_of_range_rate": float(np.mean([result.out_of_range for result in played])),
        }

    def close(self) -> None:
        """Free the environment."""
        if self._env is not None:
            self._env.close()


class _Player:
    """Plays episodes of one evaluation in one environment, built on first use."""

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
            agent.attach(self._env)
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
        path = evaluation.recordings / f"episode_{episode:03d}"
        return evaluation.make_recorder(path, evaluation.config.env, evaluation.config.viz)

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
        # Under joblib's launcher, whose start method is unknown to processes spawned here.
        multiprocessing.set_start_method("spawn", force=True)
    context = multiprocessing.get_context("spawn")  # OpenGL contexts do not survive a fork
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


_player: _Player | None = None  # one per worker process


def _start_worker(evaluation: Evaluation, stop: Event) -> None:
    global _player
    follow_parent()  # the parent sets `stop` on Ctrl-C
    atexit.register(os._exit, 0)  # freeing torch and OpenGL would take two seconds
    _player = _Player(evaluation, stopped=stop.is_set)


def _play_in_worker(episode: int) -> EpisodeResult:
    assert _player is not None
    return _player.play(episode)
