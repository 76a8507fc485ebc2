"""Hindsight experience replay (paper section V C; the authors' variant).

A push that moved objects was a good push for another goal: the one with the moved objects where
they ended. It is stored a second time with that goal, and with reward, success and done flags
recomputed for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from sdfgcn.config import EnvConfig, HerConfig
from sdfgcn.envs.reward import reward_terms
from sdfgcn.task.scene import Scene


class Hindsight:
    """Makes the hindsight transitions of a stream of pushes.

    `next` takes goals from the scene after the push itself, `future` from the scene after that or
    a later push of the episode, drawn at random, so it waits for the end of the episode.
    """

    def __init__(self, her: HerConfig, env: EnvConfig) -> None:
        """Start without unfinished episodes.

        Args:
            her: The variant, and when an object counts as moved.
            env: Reward and success threshold.
        """
        self._her = her
        self._env = env
        self._open: dict[int, list[TensorDictBase]] = {}  # unfinished, by trajectory, for `future`
        self._carried: list[TensorDictBase] = []  # of the checkpoint's unfinished episode

    def __call__(self, pushes: TensorDictBase, trajectories: Tensor) -> TensorDictBase | None:
        """Relabel all pushes that can be relabelled now.

        Args:
            pushes: [T] transitions as the replay buffer stores them.
            trajectories: int64 [T] the episode of each transition.

        Returns:
            [R] transitions with new goals; None if there are none.
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

    def state_dict(self) -> dict[str, Any]:
        """The unfinished episode, for a checkpoint."""
        episode = [*self._carried, *(push for pushes in self._open.values() for push in pushes)]
        return {"episode": torch.stack(episode).contiguous() if episode else None}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restore the unfinished episode from a checkpoint."""
        self._open.clear()
        episode = state["episode"]
        self._carried = [] if episode is None else list(episode.unbind(0))

    def forget_episode(self) -> None:
        """Drop the checkpoint's unfinished episode: the collectors start new ones."""
        self._carried = []


def relabelled(
    pushes: TensorDictBase, achieved: TensorDictBase, min_displacement: float, env: EnvConfig
) -> TensorDictBase | None:
    """Relabel pushes with the positions of the moved objects in other scenes as goals.

    Args:
        pushes: [T] transitions.
        achieved: [T] for each push, the observation from which the new goals are taken.
        min_displacement: Displacement above which an object counts as moved, metres.
        env: Reward and success threshold.

    Returns:
        [R] the pushes that moved a matched object, with goal, reward, success and done flags
        replaced; None if there are none. Pushes after which an object vanished or reappeared are
        left out, as positions do not determine their reward.
    """
    scene, outcome = pushes["scene"], pushes["next", "scene"]
    offsets = outcome.position - scene.position
    rows = offsets.norm(dim=-1) > min_displacement
    for moment in (pushes, pushes["next"], achieved):  # else the row may show another object there
        rows &= moment["matched"]
    some = rows.any(dim=-1) & (scene.node_mask == outcome.node_mask).all(dim=-1)
    if not some.any():
        return None
    chosen, rows = pushes[some].clone(), rows[some]
    goal: Scene = chosen["goal"].by_row()  # shares its memory with `chosen`
    goal[rows] = achieved["scene"][some].by_row()[rows]
    return _with_ends(chosen, env)


def _with_ends(pushes: TensorDictBase, env: EnvConfig) -> TensorDictBase:
    """Recompute reward, success and done flags, in place.

    As in `seen_standing`, an unmatched goal object counts as not at its goal, and only matched rows
    count towards progress.
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
    """[T, N] distance of each row to its goal, metres; NaN for unmatched rows."""
    distances = (scene.position - goal.position).norm(dim=-1).double()
    return torch.where(matched, distances, torch.nan).numpy()


def _joined(parts: list[TensorDictBase | None]) -> TensorDictBase | None:
    some = [part for part in parts if part is not None]
    return torch.cat(some) if some else None
