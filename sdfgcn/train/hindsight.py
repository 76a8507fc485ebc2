"""Hindsight experience replay (paper section V C; the authors' variant).

A push that moved something was a good push for another goal: the one in which the moved objects
belong where they ended. It is kept a second time with that goal, and with the reward and the end
of the episode that follow from it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from sdfgcn.config import EnvConfig, HerConfig
from sdfgcn.envs.reward import reward_terms
from sdfgcn.task.scene import Scene


class Hindsight:
    """Makes the additional transitions of a stream of pushes.

    `next` takes where the objects lie after the push itself, `future` where they lie after a
    later push of the episode, drawn at random, so it waits for the episode's end.
    """

    def __init__(self, her: HerConfig, env: EnvConfig) -> None:
        """Start without an open episode.

        Args:
            her: Which hindsight, and when an object counts as moved.
            env: Reward and success threshold.
        """
        self._her = her
        self._env = env
        self._open: dict[int, list[TensorDictBase]] = {}  # by trajectory, for `future`
        self._carried: list[TensorDictBase] = []  # of the episode that a checkpoint was taken in

    def __call__(self, pushes: TensorDictBase, trajectories: Tensor) -> TensorDictBase | None:
        """Relabel what can be relabelled now.

        Args:
            pushes: [T] transitions as the replay buffer stores them.
            trajectories: int64 [T] the episode that each belongs to.

        Returns:
            [R] transitions with other goals; None if there are none.
        """
        if self._her.name == "off":
            return None
        if self._her.name == "next":
            return self._relabelled(pushes, pushes["next"])
        finished = []
        for push, trajectory in zip(pushes.unbind(0), trajectories.tolist(), strict=True):
            episode = self._open.setdefault(trajectory, self._carried)
            self._carried = []
            episode.append(push.clone())
            if bool(push["next", "done"]):
                finished.append(self._future(torch.stack(self._open.pop(trajectory))))
        return _joined(finished)

    def _future(self, episode: TensorDictBase) -> TensorDictBase | None:
        n = len(episode)
        copies = []
        for _ in range(self._her.per_push):
            later = torch.arange(n) + (torch.rand(n) * (n - torch.arange(n))).long()
            copies.append(self._relabelled(episode, episode["next"][later]))
        return _joined(copies)

    def _relabelled(
        self, pushes: TensorDictBase, achieved: TensorDictBase
    ) -> TensorDictBase | None:
        return relabelled(pushes, achieved, self._her.min_displacement, self._env)

    def dump(self, path: Path) -> None:
        """Write the episode that is going on, for a checkpoint."""
        episode = [*self._carried, *(push for pushes in self._open.values() for push in pushes)]
        if episode:
            stacked: TensorDictBase = torch.stack(episode)  # type: ignore[assignment, arg-type]
            stacked.contiguous().memmap(path / "episode")

    def load(self, path: Path) -> None:
        """Go on with the episode that a checkpoint kept."""
        self._open.clear()
        self._carried = []
        if (path / "episode").exists():
            episode = TensorDict.load_memmap(path / "episode")
            self._carried = list(episode.clone().unbind(0))

    def forget_episode(self) -> None:
        """Drop the episode that a checkpoint kept: the collectors have begun new ones."""
        self._carried = []


def relabelled(
    pushes: TensorDictBase, achieved: TensorDictBase, min_displacement: float, env: EnvConfig
) -> TensorDictBase | None:
    """Pushes with the goals of the moved objects where they lie in other scenes.

    Args:
        pushes: [T] transitions.
        achieved: [T] the observation for each push that shows where its objects were to go.
        min_displacement: An object counts as moved when the push displaced it further, metres.
        env: Reward and success threshold.

    Returns:
        [R] those that moved a matched object, with goal, reward and ends replaced; None if there
        are none. Where an object vanished or came back, positions do not tell the reward: such
        pushes are left out.
    """
    scene, outcome = pushes["scene"], pushes["next", "scene"]
    offsets = outcome.position - scene.position
    rows = offsets.norm(dim=-1) > min_displacement
    for moment in (pushes, pushes["next"], achieved):  # else a row may show another object there
        rows &= moment["matched"]
    some = rows.any(dim=-1) & (scene.node_mask == outcome.node_mask).all(dim=-1)
    if not some.any():
        return None
    chosen, rows = pushes[some].clone(), rows[some]
    goal: Scene = chosen["goal"].by_row()  # shares its memory with `chosen`
    goal[rows] = achieved["scene"][some].by_row()[rows]
    return _with_ends(chosen, env)


def _with_ends(pushes: TensorDictBase, env: EnvConfig) -> TensorDictBase:
    """Work out reward, success and the episode's end anew; in place.

    As `sdfgcn.envs.standing` does without truth: an object of the goal that is not matched is not
    at its goal, and only matched rows tell of progress.
    """
    outcome, goal = pushes["next"], pushes["goal"]
    before = _distances(pushes["scene"], goal, pushes["matched"])
    after = _distances(outcome["scene"], goal, outcome["matched"])
    success = ((after <= env.success_threshold) | ~goal.node_mask.numpy()).all(axis=-1)
    out_of_range = outcome["out_of_range"].squeeze(-1).numpy()
    rewards = [
        sum(
            reward_terms(
                env.reward,
                before[i],
                after[i],
                success=bool(success[i]),
                out_of_range=bool(out_of_range[i]),
            ).values()
        )
        for i in range(len(pushes))
    ]
    terminated = torch.from_numpy(success | out_of_range).unsqueeze(-1)
    truncated = outcome["truncated"] & ~terminated
    news: dict[str, Any] = {
        "reward": torch.tensor(rewards, dtype=torch.float32).unsqueeze(-1),
        "success": torch.from_numpy(success).unsqueeze(-1),
        "terminated": terminated,
        "truncated": truncated,
        "done": terminated | truncated,
    }
    pushes["next"] = outcome.update(news)
    return pushes


def _distances(scene: Scene, goal: Scene, matched: Tensor) -> np.ndarray:
    """[T, N] metres from each row to its goal; NaN where it is not matched."""
    distances = (scene.position - goal.position).norm(dim=-1).double()
    return torch.where(matched, distances, torch.nan).numpy()


def _joined(parts: list[TensorDictBase | None]) -> TensorDictBase | None:
    some = [part for part in parts if part is not None]
    return torch.cat(some) if some else None
