"""Push objects into the arrangement that a goal picture shows, by Q-learning on SDF graphs."""

from __future__ import annotations

from typing import Any

__all__ = ["load_policy"]


def __getattr__(name: str) -> Any:
    """Load `load_policy`, and torch with it, when it is first asked for."""
    if name == "load_policy":
        from sdfgcn.agents.policy import load_policy

        return load_policy
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
