"""The rearrangement task as a Gymnasium env (extra [gymnasium]).

    import sdfgcn.gym_env

    gymnasium.make("sdfgcn/Rearrangement-v0", overrides=["objects=household", "robot=gripper"])

The import registers the env; `gymnasium.make("sdfgcn.gym_env:sdfgcn/Rearrangement-v0")` does both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces

if TYPE_CHECKING:
    from tensordict import TensorDictBase

Observation = dict[str, Any]

NAME = "sdfgcn/Rearrangement-v0"
_INFO = ("success", "out_of_range")


class GymRearrangement(gymnasium.Env[Observation, np.int64]):
    """A `RearrangementEnv` with Gymnasium's interface.

    Observations are dictionaries of NumPy arrays with the same keys and shapes; truth values are
    int8. An action is one index, as there. `info` holds `action_mask` (int8 [N * D], as
    `action_space.sample` takes it), `success` and `out_of_range`. An episode ends by itself
    (`env.pushes_per_object`), so no time limit is needed.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 1}  # noqa: RUF012

    def __init__(self, overrides: Sequence[str] = (), render_mode: str | None = None) -> None:
        """Build the env of a config.

        Args:
            overrides: As on the command line of `sdfgcn`.
            render_mode: "rgb_array", or None.

        Raises:
            SdfgcnError, HydraException, OmegaConfBaseException: See `sdfgcn.make_env`.
        """
        from sdfgcn.compose import load_config
        from sdfgcn.envs.rearrangement import RearrangementEnv

        self.render_mode = render_mode
        self._env = RearrangementEnv(load_config(*overrides).env)
        self.observation_space = _space(self._env.observation_spec)
        self.action_space = spaces.Discrete(self._env.action_spec.n)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; `options` are not used."""
        super().reset(seed=seed)
        self._td = self._env.reset_episode(int(self.np_random.integers(2**31)))
        return self._observed()

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Make a push."""
        import torch

        self._td["action"] = torch.tensor(int(action))
        self._td = self._env.step(self._td)["next"]
        observation, info = self._observed()
        terminated, truncated = (bool(self._td[key]) for key in ("terminated", "truncated"))
        return observation, float(self._td["reward"]), terminated, truncated, info

    def render(self) -> Any:
        """The current picture, uint8 [H, W, 3], with `render_mode="rgb_array"`."""
        if self.render_mode == "rgb_array":
            return self._env.world.look().pixels()
        return None

    def close(self) -> None:
        """Release the simulation."""
        if not self._env.is_closed:
            self._env.close()

    def _observed(self) -> tuple[Observation, dict[str, Any]]:
        space = self.observation_space
        assert isinstance(space, spaces.Dict)
        observation = _arrays(self._td, space)
        info = {key: bool(self._td[key]) for key in _INFO}
        return observation, {**info, "action_mask": observation["action_mask"]}


def _space(spec: Any) -> Any:
    """The Gymnasium space of a TorchRL spec."""
    import torch
    from torchrl.data import Composite

    if isinstance(spec, Composite):
        return spaces.Dict({key: _space(inner) for key, inner in spec.items()})
    if spec.dtype == torch.bool:
        return spaces.MultiBinary(tuple(spec.shape))
    dtype: Any = torch.empty(0, dtype=spec.dtype).numpy().dtype
    low, high = -np.inf, np.inf
    if np.issubdtype(dtype, np.integer):
        low, high = np.iinfo(dtype).min, np.iinfo(dtype).max
    return spaces.Box(low, high, tuple(spec.shape), dtype)


def _arrays(td: TensorDictBase, space: spaces.Dict) -> Observation:
    """What a space contains of a TensorDict, as arrays of their own."""
    return {
        key: _arrays(td.get(key), inner)
        if isinstance(inner, spaces.Dict)
        else td.get(key).numpy().astype(inner.dtype)
        for key, inner in space.items()
    }


gymnasium.register(NAME, f"{__name__}:{GymRearrangement.__name__}")
