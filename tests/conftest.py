"""Set-up for all tests, and the environments that they share."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from functools import cache
from typing import TYPE_CHECKING

import pytest

# Tests run side by side, a process for each core: more threads than that wait for each other.
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import sdfgcn  # noqa: E402, F401 - sets MUJOCO_GL, which MuJoCo reads when it loads

if TYPE_CHECKING:
    from sdfgcn.envs.rearrangement import RearrangementEnv

Envs = Callable[..., "RearrangementEnv"]


@pytest.fixture(scope="session")
def env_of() -> Iterator[Envs]:
    """Environments with household objects, by overrides; each is built once and shared.

    A test begins an episode of its own and leaves nothing switched on.
    """
    from configs import real_config

    from sdfgcn.envs.rearrangement import RearrangementEnv

    with ExitStack() as stack:

        @cache
        def build(*overrides: str) -> RearrangementEnv:
            config = real_config("objects=household", *overrides)
            return stack.enter_context(closing(RearrangementEnv(config.env, seed=0)))

        yield build


@pytest.fixture(scope="session")
def toys_of() -> Iterator[Envs]:
    """The same with the plain bodies of `toys.py`, by robot and overrides."""
    from configs import real_config
    from toys import toy_env

    with ExitStack() as stack:

        @cache
        def build(robot: str, *overrides: str) -> RearrangementEnv:
            config = real_config("objects=household", f"robot={robot}", *overrides)
            return stack.enter_context(closing(toy_env(config.env)))

        yield build
