"""What an update saves by computing only the values that it needs, by number of objects.

    python experiments/benchmark_learner.py
    python experiments/benchmark_learner.py repeats=15 updates=5 model=separate

One learner leaves double DQN to TorchRL's loss, which computes the values of all objects three
times; the other asks for one object's value where that is enough (`sdfgcn/train/learner.py`). They
take turns on one thread, and the order of the turns changes, so that other processes slow down
both. Writes `benchmark_learner.json`: CPU time per update, and the ratio of each turn.
"""

from __future__ import annotations

import os
import sys

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import statistics
import time
from typing import Any

import torch
from benchmark_models import observation
from common import load, parse, run, save
from tensordict import TensorDict
from tqdm import tqdm

from sdfgcn.config import Config
from sdfgcn.models import build_q_network
from sdfgcn.provenance import provenance
from sdfgcn.task.push_space import PushSpace
from sdfgcn.train.learner import Learner

N_OBJECTS = (3, 6)


def transitions(config: Config, n_objects: int) -> TensorDict:
    """A random batch of transitions in which all objects are in sight and matched."""
    batch, directions = config.train.batch_size, config.env.push.directions
    size = config.env.arena.image_size
    td, after = (observation(n_objects, batch, n_objects, size) for _ in range(2))
    mask = torch.ones(batch, n_objects * directions, dtype=torch.bool)
    td["action_mask"] = after["action_mask"] = mask
    td["action"] = torch.arange(batch) % mask.shape[-1]
    after["goal"] = td["goal"]
    after["reward"] = torch.linspace(-1.0, 1.0, batch).unsqueeze(-1)
    after["terminated"] = after["done"] = torch.arange(batch).unsqueeze(-1) % 10 == 0
    return td.set("next", after)


def learner(config: Config, n_objects: int, all_values: bool) -> Learner:
    """A learner with an untrained network."""
    env = config.env
    directions, size = env.push.directions, env.arena.image_size
    network = build_q_network(config.model, directions, n_objects, size, config.seed)
    actions = PushSpace(env.push, env.arena).spec(n_objects)
    return Learner(network, actions, config.train, "cpu", all_values)


def cpu_ms(held: Learner, batch: TensorDict, updates: int) -> float:
    """CPU time per update, milliseconds."""
    began = time.process_time()
    for _ in range(updates):
        held.update(batch.copy())
    return 1e3 * (time.process_time() - began) / updates


def measure(config: Config, n_objects: int, repeats: int, updates: int) -> dict[str, Any]:
    """Let the two learners take turns."""
    batch = transitions(config, n_objects)
    learners = {all_values: learner(config, n_objects, all_values) for all_values in (True, False)}
    for held in learners.values():
        held.update(batch.copy())  # the first update allocates
    turns: dict[bool, list[float]] = {True: [], False: []}
    for turn in tqdm(range(repeats), unit="turn", desc=f"{n_objects} objects"):
        for which in (True, False) if turn % 2 else (False, True):
            turns[which].append(cpu_ms(learners[which], batch, updates))
    ratios = sorted(every / asked for every, asked in zip(turns[True], turns[False], strict=True))
    return {
        "n_objects": n_objects,
        "all_values_ms": round(statistics.median(turns[True]), 1),
        "asked_values_ms": round(statistics.median(turns[False]), 1),
        "ratio": round(statistics.median(ratios), 3),
        "least_and_largest_ratio": [round(ratios[0], 3), round(ratios[-1], 3)],
    }


def main() -> None:
    own, overrides, folder = parse(sys.argv[1:], {"repeats": 15, "updates": 3}, __doc__ or "")
    torch.set_num_threads(1)
    config = load(["model=sdfgcn", *overrides])
    rows = [measure(config, n_objects, **own) for n_objects in N_OBJECTS]
    machine = {
        "capability": torch.backends.cpu.get_cpu_capability(),
        "load_average": os.getloadavg()[0],
    }
    case = {"model": config.model.name, "batch": config.train.batch_size, **own}
    save(folder, "benchmark_learner", {**case, "machine": machine, **provenance(), "rows": rows})


if __name__ == "__main__":
    sys.exit(run(main))
