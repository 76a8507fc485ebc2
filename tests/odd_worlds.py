"""Apart from point_world.py: a worker that needs no torch is there in a second."""

import os
import sys
import time
from pathlib import Path

from configs import real_config

from sdfgcn.config import EnvConfig
from sdfgcn.evaluation.evaluate import Env, Evaluation, evaluate
from sdfgcn.registry import RECORDERS


def dying_world(config: EnvConfig) -> Env:
    """End the process at once, as the kernel does when memory runs out."""
    os._exit(9)


def sleeping_world(config: EnvConfig) -> Env:
    """Tell that the worker is there, and never come back."""
    print("asleep", flush=True)
    time.sleep(3600)
    raise AssertionError


if __name__ == "__main__":
    config = real_config("runtime.workers=2", "eval.episodes=2")
    list(evaluate(Evaluation(config, Path(sys.argv[1]), RECORDERS["none"], sleeping_world)))
