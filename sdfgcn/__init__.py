"""Push objects into the arrangement shown in a goal picture, by Q-learning on SDF graphs.

env = sdfgcn.make_env("objects=household", "robot=gripper")
policy = sdfgcn.load_policy("sdfgcn")
observation = policy(env.reset())
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sdfgcn.agents.policy import load_policy
    from sdfgcn.compose import conf_dir, load_config
    from sdfgcn.envs.rearrangement import RearrangementEnv

__all__ = ["__version__", "conf_dir", "load_config", "load_policy", "make_env"]
__version__ = "0.1.0"

os.environ.setdefault("MUJOCO_GL", "egl")  # before MuJoCo loads: render without a display


def make_env(*overrides: str) -> RearrangementEnv:
    """Build the environment of a config.

    Args:
        overrides: As on the command line, such as `make_env("n_objects=2", "robot=gripper")`.

    Raises:
        SdfgcnError, HydraException, OmegaConfBaseException: See `load_config`, and
            `RearrangementEnv`.
    """
    from sdfgcn.compose import load_config
    from sdfgcn.envs.rearrangement import RearrangementEnv

    return RearrangementEnv(load_config(*overrides).env)


def __getattr__(name: str) -> Any:
    """Import slow modules, torch above all, only on first use."""
    if name in ("conf_dir", "load_config"):
        from sdfgcn import compose

        return getattr(compose, name)
    if name == "load_policy":
        from sdfgcn.agents.policy import load_policy

        return load_policy
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
