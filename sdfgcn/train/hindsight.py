"""Hindsight experience replay (paper section V C; the authors' variant).

A push that moved something was a good push for another goal: the one in which the moved objects
belong where they ended. It is kept a second time with that goal, and with the reward and end of
episode that follow from it.
"""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from sdfgcn.config import EnvConfig, HerConfig
from sdfgcn.sim.reward import reward_terms

_NODE_KEYS = ("sdf", "node_mask", "center")


class Hindsight:
    """Makes the additional transitions of a stream of pushes.

    `next` takes where the objects lie after the push itself, `future` where they lie after a
    push drawn from the rest of the episode, so it waits for the episode's end.
    """

    def __init__(self, her: HerConfig, env: EnvConfig) -> None:
        self._her = her
        self._env = env
        self._open: dict[int, list[TensorDictBase]] = {}  # by trajectory, for `future`

    def __call__(self, collected: TensorDictBase) -> TensorDictBase | None:
        """Relabel what can be relabelled now.

        Args:
            collected: [T] pushes as a collector hands them over.

        Returns:
            [R] transitions with other goals; None if there are none.
        """
        if self._her.name == "off":
            return None
        if self._her.name == "next":
            return relabelled(collected, collected["next"], self._her.min_displacement, self._env)
        return self._future(collected)

    def _future(self, collected: TensorDictBase) -> TensorDictBase | None:
        found = []
        for push in collected.unbind(0):
            trajectory = int(push["collector", "traj_ids"])
            episode = self._open.setdefault(trajectory, [])
            episode.append(push.clone())
            if bool(push["next", "done"]):
                found.append(self._finished(torch.stack(self._open.pop(trajectory))))
        some = [part for part in found if part is not None]
        return torch.cat(some) if some else None

    def _finished(self, episode: TensorDictBase) -> TensorDictBase | None:
        n = len(episode)
        some = []
        for _ in range(self._her.per_push):
            later = torch.arange(n) + (torch.rand(n) * (n - torch.arange(n))).long()
            some.append(
                relabelled(episode, episode["next"][later], self._her.min_displacement, self._env)
            )
        kept = [part for part in some if part is not None]
        return torch.cat(kept) if kept else None


def relabelled(
    pushes: TensorDictBase, achieved: TensorDictBase, moved: float, env: EnvConfig
) -> TensorDictBase | None:
    """Pushes with the goals of the moved objects where they lie in other scenes.

    Args:
        pushes: [T] as a collector hands them over.
        achieved: [T] the observation for each push that shows where its objects were to go.
        moved: An object counts as moved when the push displaced it further, metres.
        env: Reward and success threshold.

    Returns:
        [R] those that moved a detected object, with goal, reward and ends replaced; None if there
        are none. Where an object vanished or came back, positions do not tell the reward: such
        pushes are left out.
    """
    offsets = pushes["next", "position"] - pushes["position"]
    rows = (offsets.norm(dim=-1) > moved) & pushes["node_mask"] & achieved["node_mask"]
    rows &= pushes["correspondence"] >= 0
    some = rows.any(dim=-1) & (pushes["node_mask"] == pushes["next", "node_mask"]).all(dim=-1)
    if not some.any():
        return None
    return _with_ends(_with_goals(pushes[some].clone(), achieved[some], rows[some]), env)


def _with_goals(pushes: TensorDictBase, achieved: TensorDictBase, rows: Tensor) -> TensorDictBase:
    push, row = rows.nonzero(as_tuple=True)
    goal_row = pushes["correspondence"][push, row]
    for key in _NODE_KEYS:
        pushes["goal_" + key][push, goal_row] = achieved[key][push, row]
    pushes["goal_position"][push, row] = achieved["position"][push, row]  # by object, not by node
    return pushes


def _with_ends(pushes: TensorDictBase, env: EnvConfig) -> TensorDictBase:
    """Work out reward, success and the episode's end anew; in place."""
    outcome = pushes["next"]
    before = (pushes["position"] - pushes["goal_position"]).norm(dim=-1).double().numpy()
    after = (outcome["position"] - pushes["goal_position"]).norm(dim=-1).double().numpy()
    success = (after <= env.success_threshold).all(axis=-1)
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
    terminated = success | out_of_range
    news = TensorDict(
        {
            "reward": torch.tensor(rewards, dtype=torch.float32).unsqueeze(-1),
            "success": torch.from_numpy(success).unsqueeze(-1),
            "terminated": torch.from_numpy(terminated).unsqueeze(-1),
            "truncated": outcome["truncated"] & ~torch.from_numpy(terminated).unsqueeze(-1),
        },
        batch_size=pushes.batch_size,
    )
    news["done"] = news["terminated"] | news["truncated"]
    pushes["next"] = outcome.update(news)
    return pushes
