"""Apart from point_world.py: a worker that needs no torch is there in a second."""

import os

from sdfgcn.config import EnvConfig


def dying_world(config: EnvConfig) -> None:
    """End the process at once, as the kernel does when memory runs out."""
    os._exit(9)
