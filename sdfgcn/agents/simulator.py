"""The bound of a planner that looks one push ahead: its model is the simulator itself.

It tries pushes in the world and takes them back, so it knows exactly where each one leads. What it
does not reach, no model of single pushes reaches with the same score (`sdfgcn/models/planner.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor

from sdfgcn.config import Config, ModelConfig, at_least
from sdfgcn.errors import SdfgcnError
from sdfgcn.models.planner import PlannerConfig, pushes_needed
from sdfgcn.registry import MODELS
from sdfgcn.task.push_space import PushSpace
from sdfgcn.task.region import Region

if TYPE_CHECKING:
    from sdfgcn.envs.rearrangement import RearrangementEnv

_NOT_TRIED = -1e6  # the preference for pushes that were not tried


@dataclass
class SimulatorConfig(ModelConfig):
    """The planner whose model is the simulator (`conf/model/simulator.yaml`).

    Attributes:
        nearest: The pushes tried first of each object away from its goal, those nearest to the way
            there; if none helps, all legal ones are tried.
        planner: How the outcome is scored; only one push ahead.
    """

    nearest: int = at_least(1)
    planner: PlannerConfig = field(default_factory=PlannerConfig)

    def check(self, config: Config) -> None:
        """See `ComponentConfig`."""
        if self.planner.depth != 1:
            raise SdfgcnError(
                f"model.planner.depth is {self.planner.depth}, but model=simulator looks one push "
                "ahead; set it to 1."
            )


@MODELS.register("simulator", config=SimulatorConfig)
class SimulatorPlanner:
    """Prefers the push after which the fewest pushes are needed."""

    def __init__(self, config: Config, rng: np.random.Generator) -> None:
        """Read the config; `rng` is unused."""
        assert isinstance(config.model, SimulatorConfig)
        self._config = config.model
        self._threshold = config.env.success_threshold
        self._pushes = PushSpace(config.env.push, config.env.arena)
        self._allowed = Region.range(config.env.arena)
        self._env: RearrangementEnv | None = None

    def attach(self, env: RearrangementEnv) -> None:
        """Set the env in whose world pushes are tried."""
        self._env = env

    def __call__(self, td: TensorDictBase) -> Tensor:
        """Rank the pushes; see `sdfgcn.agents.epsilon_greedy.Agent`.

        Raises:
            SdfgcnError: There is no world in which pushes can be tried.
        """
        if self._env is None:
            raise SdfgcnError(
                "model=simulator tries pushes in the world of an env, but has none; evaluate it "
                "with run.py, or call attach(env) first."
            )
        before = self._needed(self._env.world.poses())
        preferences = torch.full((td["action_mask"].shape[-1],), _NOT_TRIED)
        for actions in self._candidates(td):
            for action in actions:
                after = self._env.foresee(action)
                preferences[action] = before - self._needed(after)
            if (preferences > 0.0).any():
                break
        return preferences

    def _candidates(self, td: TensorDictBase) -> tuple[list[int], list[int]]:
        """The pushes to try first, of objects away from their goals; and all others."""
        legal = self._pushes.by_direction(td["action_mask"]).numpy()
        offsets = (td["goal", "position"] - td["scene", "position"]).double().numpy()
        away = np.linalg.norm(offsets, axis=-1) > self._config.planner.aim
        first = []
        for row in np.flatnonzero((td["matched"] & td["scene", "node_mask"]).numpy() & away):
            ranked = [int(k) for k in self._pushes.nearest(offsets[row]) if legal[row, k]]
            first += [self._pushes.encode(int(row), k) for k in ranked[: self._config.nearest]]
        others = np.setdiff1d(np.flatnonzero(legal.ravel()), first)
        return first, others.tolist()

    def _needed(self, poses: NDArray[np.float64] | None) -> float:
        """Pushes needed from true poses [n, 7], with those that being out of range costs."""
        assert self._env is not None
        truth = self._env.world.truth
        assert poses is not None and truth is not None
        way = torch.from_numpy(np.linalg.norm((poses - truth.goal_poses)[:, :2], axis=-1))
        needed = pushes_needed(self._config.planner, self._threshold, way, torch.zeros(()))
        out = ~self._allowed.contains(poses[:, :2])
        return float(needed.sum()) + self._config.planner.risk * int(out.sum())
