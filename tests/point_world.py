"""Environments of points for the tests of what plays episodes: quick, and workable by hand.

A push moves one point by exactly STEP in its direction and earns 1. Functions here are at the top
of a module so that a worker process can be given them.
"""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
from sdfgcn.envs.types import StepRecord
from sdfgcn.sim.types import Push
from tensordict import TensorDict

from sdfgcn.config import N_DIRECTIONS, EnvConfig

STEP = 0.06  # m
NAMES = ("apple", "brick", "cup", "disc", "egg", "fork", "glove", "hat")


class PointWorld:
    """n points on a plane, each with a goal; nothing collides."""

    def __init__(self, config: EnvConfig) -> None:
        self.config = config
        self.record = False
        self.closed = False

    def reset_episode(self, seed: int) -> TensorDict:
        rng = np.random.default_rng(seed)
        self.place(rng.uniform(-0.25, 0.25, (2, self.config.n_objects, 2)))
        return self.observe()

    def place(self, start_and_goal: np.ndarray) -> None:
        self.position, self.goal = start_and_goal
        self.pushes = 0
        objects = tuple(SimpleNamespace(name=name) for name in NAMES[: len(self.position)])
        self.episode_start = SimpleNamespace(objects=objects)

    def step(self, td: TensorDict) -> TensorDict:
        slot, direction = divmod(int(td["action"]), N_DIRECTIONS)
        angle = direction * np.pi / 4
        start = self.position[slot].copy()
        self.position[slot] += STEP * np.array([np.cos(angle), np.sin(angle)])
        self.pushes += 1
        distances = np.linalg.norm(self.position - self.goal, axis=1)
        success = bool((distances < self.config.success_threshold).all())
        limit = self.config.pushes_per_object * len(self.position)
        truncated = not success and self.pushes >= limit
        self.last_step = StepRecord(
            index=self.pushes,
            push=Push(
                slot, direction, np.append(start, 0), np.append(self.position[slot], 0), "done"
            ),
            scene=None,
            distances=distances,
            reward_terms={"step": 1.0},
            reward=1.0,
            success=success,
            out_of_range=False,
            terminated=success,
            truncated=truncated,
            q_values=None,
        )
        after = self.observe()
        after["reward"] = torch.ones(1)
        after["done"] = torch.tensor([success or truncated])
        td["next"] = after
        return td

    def observe(self) -> TensorDict:
        n = self.config.max_objects
        nodes = torch.arange(n) < len(self.position)
        padded = np.zeros((2, n, 2), dtype=np.float32)
        padded[:, : len(self.position)] = self.position, self.goal
        return TensorDict(
            {
                "position": torch.from_numpy(padded[0]),
                "goal_position": torch.from_numpy(padded[1]),
                "correspondence": torch.where(nodes, torch.arange(n), -1),
                "node_mask": nodes,
                "action_mask": nodes.repeat_interleave(N_DIRECTIONS),
            }
        )

    def close(self) -> None:
        self.closed = True


class Endless(PointWorld):
    """Never ends an episode, but for the first one begun, in which the simulation breaks."""

    def reset_episode(self, seed: int) -> TensorDict:
        if Path(os.environ["FIRST_EPISODE"]).exists():
            Path(os.environ["FIRST_EPISODE"]).unlink()
            raise FloatingPointError("the simulation broke")
        return super().reset_episode(seed)

    def step(self, td: TensorDict) -> TensorDict:
        td = super().step(td)
        td["next", "done"][:] = False
        return td


class Notes:
    """A recorder that writes what it was given as text."""

    def __init__(self, path: Path, env: EnvConfig) -> None:
        self.path = path

    def __enter__(self) -> "Notes":
        self.lines: list[str] = []
        return self

    def __exit__(self, *error: object) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text("\n".join(self.lines))

    def start(self, episode: object) -> None:
        self.lines.append("start")

    def step(self, step: StepRecord) -> None:
        self.lines.append(f"push {step.index}")
