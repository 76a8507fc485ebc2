"""The cost of an update of each Q-network: CPU time on one thread, and operations per node.

    python experiments/benchmark_models.py                  all networks and widths, 3 objects
    python experiments/benchmark_models.py batch=64 n_objects=4 repeats=5 bfloat16=1

A double DQN update is a forward and a backward pass on the observations, and two forward passes on
the next ones; here all compute all values, of which a learner asks for fewer
(`benchmark_learner.py`). Times are the least CPU time of the repeats, since other processes only
add to it. Writes `benchmark_models.json`. `bfloat16=1` also tries autocast, which takes ten
times as long on a processor that has to emulate it.
"""

from __future__ import annotations

import os
import sys

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import platform
import time
from collections.abc import Callable
from typing import Any

import torch
from common import load, parse, run, save
from tensordict import TensorDict
from torch.utils.flop_counter import FlopCounterMode
from tqdm import tqdm

from sdfgcn.models import build_q_network
from sdfgcn.models.q_network import QNetwork
from sdfgcn.task.scene import Scene

# Network, width (None: not configurable), and the numbers of rows and the formats to try.
PLAIN = ((4, "float32"), (4, "channels_last"))
CASES: list[tuple[str, str | None, tuple[tuple[int, str], ...]]] = [
    ("sdfgcn", "strided", (*PLAIN, (8, "channels_last"), (4, "bfloat16"))),
    ("sdfgcn", "fine", PLAIN),
    ("sdfgcn", "paper", PLAIN),
    ("separate", "strided", PLAIN),
    ("segmentation_gcn", "strided", PLAIN),
    ("pose_gcn", None, ((4, "float32"),)),
    ("gt_pose_gcn", None, ((4, "float32"),)),
    ("sdf_cnn", "strided", PLAIN),
]


def observation(n: int, batch: int, n_objects: int, size: int) -> TensorDict:
    """A random observation with the environment's keys; times do not depend on its content."""
    generator = torch.Generator().manual_seed(0)
    occupied = (torch.arange(n) < n_objects).repeat(batch, 1)

    def scene() -> Scene:
        return Scene(
            sdf=torch.randn(batch, n, size, size, generator=generator) * 40,
            node_mask=occupied,
            center=torch.rand(batch, n, 2, generator=generator) - 0.5,
            position=torch.rand(batch, n, 2, generator=generator) - 0.5,
            batch_size=[batch],
        )

    return TensorDict({"scene": scene(), "goal": scene(), "matched": occupied}, [batch])


def cpu_ms(function: Callable[[], Any], repeats: int) -> float:
    """The least CPU time of a call, milliseconds."""
    function()
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        function()
        taken.append(time.process_time() - began)
    return round(1e3 * min(taken), 1)


def measure(network: QNetwork, td: TensorDict, form: str, repeats: int) -> dict[str, float]:
    """Time one network in one format."""
    if form == "channels_last":
        network.to(memory_format=torch.channels_last)
    low = torch.autocast("cpu", torch.bfloat16, enabled=form == "bfloat16")

    def forward() -> None:
        with torch.no_grad(), low:
            network(td)

    def backward() -> None:
        with low:
            values = network(td)["action_value"]
        values.square().mean().backward()

    forward_ms, backward_ms = cpu_ms(forward, repeats), cpu_ms(backward, repeats)
    return {
        "forward_ms": forward_ms,
        "forward_and_backward_ms": backward_ms,
        "update_ms": round(backward_ms + 2 * forward_ms, 1),
    }


def mflop_a_node(network: QNetwork, td: TensorDict, n_nodes: int) -> float:
    """Millions of operations of a forward pass per occupied node (2 per multiply-add)."""
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        network(td)
    return round(counter.get_total_flops() / n_nodes / 1e6, 2)


def main() -> None:
    defaults = {"batch": 32, "n_objects": 3, "repeats": 5, "bfloat16": 0}
    own, overrides, folder = parse(sys.argv[1:], defaults, __doc__ or "")
    torch.set_num_threads(1)
    rows = []
    for name, width, formats in tqdm(CASES, unit="network"):
        chosen = [f"model={name}", *([f"model.width={width}"] if width else [])]
        config = load([*chosen, *overrides])
        size = config.env.arena.image_size
        for n, form in formats:
            if form == "bfloat16" and not own["bfloat16"]:
                continue
            network = build_q_network(config.model, config.env.push.directions, n, size, 0)
            td = observation(n, own["batch"], own["n_objects"], size)
            rows.append(
                {
                    "model": name,
                    "width": width,
                    "max_objects": n,
                    "format": form,
                    "parameters": sum(weights.numel() for weights in network.parameters()),
                    "mflop_a_node": mflop_a_node(network, td, 2 * own["batch"] * own["n_objects"]),
                    **measure(network, td, form, own["repeats"]),
                }
            )
            tqdm.write(str(rows[-1]))
    capability = torch.backends.cpu.get_cpu_capability()
    machine = {"processor": platform.machine(), "capability": capability, "threads": 1}
    versions = {"torch": torch.__version__, "python": platform.python_version()}
    save(
        folder, "benchmark_models", {**own, "machine": machine, "versions": versions, "rows": rows}
    )


if __name__ == "__main__":
    sys.exit(run(main))
