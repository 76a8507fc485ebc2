"""Environments of points for the tests of what plays episodes: quick, and workable by hand.

A push moves one point by exactly STEP in its direction and earns 1. Functions here are at the top
of a module so that a worker process can be given them.
"""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
from tensordict import TensorDict

from sdfgcn.config import EnvConfig, VizConfig
from sdfgcn.envs.records import EpisodeStart, Push, Snapshot, StepRecord
from sdfgcn.task.camera import camera_model
from sdfgcn.task.push_space import PushSpace
from sdfgcn.task.scene import Detections, Scene
from sdfgcn.task.world import PushResult, Truth

STEP = 0.06  # m
NAMES = ("apple", "brick", "cup", "disc", "egg", "fork", "glove", "hat")
SIZE = 4  # pixels; the pictures are empty


class PointWorld:
    """n points on a plane, each with a goal; nothing collides."""

    def __init__(self, config: EnvConfig) -> None:
        self.config = config
        self.push_space = PushSpace(config.push, config.arena)
        self.camera = camera_model(config.arena)
        self.record = False
        self.closed = False

    def reset_episode(self, seed: int) -> TensorDict:
        rng = np.random.default_rng(seed)
        return self.place(*rng.uniform(-0.25, 0.25, (2, self.config.n_objects, 2)), seed)

    def place(self, start: np.ndarray, goal: np.ndarray, seed: int = 0) -> TensorDict:
        """Begin an episode with points at [n, 2] metres."""
        self.position, self.goal = start.copy(), self.moment(goal)
        self.pushes = 0
        n = len(start)
        self.episode_start = EpisodeStart(
            seed=seed,
            n_objects=n,
            truth=Truth(
                objects=tuple(SimpleNamespace(name=name) for name in NAMES[:n]),
                colors=np.ones((n, 4)),
                goal_poses=self.goal.poses,
            ),
            start=self.moment(start),
            goal=self.goal,
            camera=self.camera,
        )
        return self.observe()

    def moment(self, points: np.ndarray) -> Snapshot:
        """Points at [n, 2] metres, each in the row of its index."""
        n = len(points)
        seen = Detections(
            masks=np.zeros((n, SIZE, SIZE), dtype=bool),
            sdf=np.ones((n, SIZE, SIZE), dtype=np.float32),
            center=points,
            position=points,
        )
        rows = np.arange(self.config.max_objects) < n
        scene = Scene.of(seen, rows, self.config.max_objects, SIZE)
        return Snapshot(scene, rows, None, np.hstack([points, np.tile([0, 1, 0, 0, 0], (n, 1))]))

    def step(self, td: TensorDict) -> TensorDict:
        row, direction = self.push_space.decode(int(td["action"]))
        angle = float(self.push_space.angles[direction])
        start = self.position[row].copy()
        self.position[row] += STEP * np.array([np.cos(angle), np.sin(angle)])
        self.pushes += 1
        after = self.moment(self.position)
        distances = np.linalg.norm((after.poses - self.goal.poses)[:, :2], axis=1)
        success = bool((distances < self.config.success_threshold).all())
        limit = self.config.pushes_per_object * len(self.position)
        truncated = not success and self.pushes >= limit
        end = self.position[row]
        self.last_step = StepRecord(
            index=self.pushes,
            push=Push(
                row, direction, angle, PushResult("done", np.append(start, 0), np.append(end, 0))
            ),
            after=after,
            distances=distances,
            reward_terms={"step": 1.0},
            reward=1.0,
            success=success,
            out_of_range=False,
            terminated=success,
            truncated=truncated,
            legal=self.push_space.by_direction(td["action_mask"]).numpy(),
        )
        td["next"] = self.observe()
        td["next", "reward"] = torch.ones(1)
        td["next", "done"] = torch.tensor([success or truncated])
        return td

    def observe(self) -> TensorDict:
        now = self.moment(self.position)
        matched = torch.from_numpy(now.matched)
        return TensorDict(
            {
                "scene": now.scene,
                "goal": self.goal.scene,
                "matched": matched,
                "action_mask": matched.repeat_interleave(self.push_space.n_directions),
                "pushes": torch.tensor([self.pushes]),
                "n_objects": torch.tensor([len(self.position)]),
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

    def __init__(self, path: Path, env: EnvConfig, viz: VizConfig | None = None) -> None:
        self.path = path

    def __enter__(self) -> "Notes":
        self.lines: list[str] = []
        return self

    def __exit__(self, *error: object) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_text("\n".join(self.lines))

    def start(self, episode: EpisodeStart) -> None:
        self.lines.append("start")

    def step(self, step: StepRecord) -> None:
        self.lines.append(f"push {step.index}")
