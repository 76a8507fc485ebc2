"""A world without MuJoCo and without truth: coloured squares that are pushed over a flat table.

The camera looks straight down, so a pixel is 5 mm everywhere and a square that lies on a whole
multiple of 5 mm is seen exactly there.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from configs import compose_config
from numpy.typing import NDArray
from omegaconf import OmegaConf

from sdfgcn.config import (
    ArenaConfig,
    Config,
    EnvConfig,
    EvalConfig,
    ModelConfig,
    PerceptionConfig,
    PushConfig,
    RewardConfig,
)
from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.base import Perception
from sdfgcn.registry import PERCEPTIONS
from sdfgcn.task.camera import camera_model
from sdfgcn.task.world import PushCommand, PushResult

STEP = 0.06  # m that a push moves a square
HALF = 3  # pixels, half a side
COLORS = np.array([[200, 40, 40], [40, 200, 40], [40, 40, 200]], dtype=np.uint8)

Points = Sequence[tuple[float, float]]


class SquareView:
    """The squares at [n, 2] points; NaN: taken off the table."""

    def __init__(self, world: SquareWorld, points: NDArray[np.float64]) -> None:
        self._world, self._points = world, points.copy()

    def pixels(self) -> NDArray[np.uint8]:
        size = self._world.camera.size
        picture = np.full((size, size, 3), 120, dtype=np.uint8)
        for (x, y), color in zip(self._points, COLORS, strict=False):
            if np.isfinite(x):
                column, row = np.round(self._world.camera.project([x, y, 0.0])).astype(int)
                picture[row - HALF : row + HALF, column - HALF : column + HALF] = color
        return picture

    def true_masks(self) -> NDArray[np.bool_]:
        raise SdfgcnError("A real table does not know its true masks.")


class SquareWorld:
    """Always the same episode; a push moves the square that is nearest to where it starts."""

    def __init__(self, config: EnvConfig, start: Points, goal: Points) -> None:
        self.camera = camera_model(config.arena)
        self.n_objects = len(start)
        self.truth = None
        self.closed = False
        self._start, self._goal = np.array(start), np.array(goal)
        self.points = self._start.copy()

    def reset(self, seed: int, n_objects: int) -> None:
        self.points = self._start.copy()

    def look_at_goal(self) -> SquareView:
        return SquareView(self, self._goal)

    def look(self) -> SquareView:
        return SquareView(self, self.points)

    def execute(self, command: PushCommand) -> PushResult:
        begin = np.append(command.start, 0.0)
        if np.isnan(command.start).any():
            return PushResult("unreachable", begin, begin)
        move = STEP * np.array([np.cos(command.angle), np.sin(command.angle)])
        distances = np.linalg.norm(self.points - command.start, axis=1)
        self.points[np.nan_to_num(distances, nan=np.inf).argmin()] += move
        return PushResult("done", begin, begin + np.append(move, 0.0))

    def poses(self) -> None:
        return None

    def save_state(self) -> dict[str, Any]:
        raise SdfgcnError("A real table cannot go back.")

    def restore_state(self, state: dict[str, Any]) -> None:
        raise SdfgcnError("A real table cannot go back.")

    def close(self) -> None:
        self.closed = True


class SquarePerception(Perception):
    """Finds the squares by their colours; row i is colour i."""

    def see_goal(self, view: SquareView) -> NDArray[np.bool_]:
        return (view.pixels() == COLORS[:, None, None]).all(axis=-1)

    def see(self, view: SquareView) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        masks = self.see_goal(view)
        return masks, masks.any(axis=(1, 2))


def square_config() -> Config:
    """What a world without a simulation needs of the config: no robot, no catalogue, no physics."""
    values: Any = OmegaConf.to_container(compose_config().env, resolve=True)
    arena = replace(
        ArenaConfig(**values["arena"]),
        camera_tilt=0.0,
        camera_fovy=float(np.degrees(2 * np.arctan(0.24))),
        camera_distance=1.0,
        camera_target=[0.0, 0.0],
        range_x=[-0.15, 0.15],
        range_y=[-0.15, 0.15],
    )
    env = EnvConfig(
        n_objects=2,
        max_objects=4,
        pushes_per_object=10,
        success_threshold=0.05,
        pixels=False,
        arena=arena,
        push=replace(PushConfig(**values["push"]), plane_height=0.0),
        reward=RewardConfig(**values["reward"]),
        perception=PerceptionConfig(name="squares", min_pixels=10, sdf="edt"),
    )
    evaluation = EvalConfig(epsilon=0.0, loop_distance=None)
    return Config(env=env, model=ModelConfig(name="rule_based"), eval=evaluation)


if __name__ == "__main__":
    sys.modules["mujoco"] = sys.modules["dm_control"] = None  # as where they are not installed

    from sdfgcn.agents import build_agent
    from sdfgcn.envs.rearrangement import RearrangementEnv
    from sdfgcn.evaluation.evaluate import play_episode

    PERCEPTIONS.register("squares")(SquarePerception)
    config = square_config()
    world = SquareWorld(config.env, [(-0.12, 0.0), (0.1, 0.1)], [(0.0, 0.0), (0.1, 0.1)])
    env = RearrangementEnv(config.env, seed=0, world=world)
    played = play_episode(env, build_agent(config, np.random.default_rng(0)), episode=0, seed=0)
    print(played.success, played.pushes, "sdfgcn.sim" in sys.modules)
