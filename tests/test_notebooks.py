"""The notebooks run from top to bottom, and are kept with the outputs of such a run."""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

import nbformat
import pytest
from configs import compose_config, real_config
from jupyter_client import KernelManager
from nbclient import NotebookClient

from sdfgcn.agents.policy import save_policy
from sdfgcn.evaluation.episodes import EpisodeResult
from sdfgcn.models import build_q_network
from sdfgcn.run_folder import RunFolder
from sdfgcn.train.progress import columns

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
QUICK = ["objects=household", "robot=gripper", "n_objects=2", "env.pushes_per_object=2"]


@pytest.fixture(scope="module")
def kernel() -> Iterator[KernelManager]:
    """One process for all notebooks: most of their time goes into loading packages."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    manager = KernelManager()
    manager.start_kernel(cwd=str(ROOT / "notebooks"), env=environment)
    yield manager
    manager.shutdown_kernel(now=True)


def execute(kernel: KernelManager, name: str, **parameters: object) -> str:
    """Run a notebook with other parameters, without the names that an earlier one left.

    Returns:
        What its cells printed and showed, as text.
    """
    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    (place,) = (
        index
        for index, cell in enumerate(notebook.cells)
        if "parameters" in cell.metadata.get("tags", ())
    )
    defaults: dict[str, object] = {}
    exec(notebook.cells[place].source, defaults)
    assert parameters.keys() <= defaults.keys()
    news = "\n".join(f"{key} = {value!r}" for key, value in parameters.items())
    notebook.cells.insert(place + 1, nbformat.v4.new_code_cell(news))
    notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))
    NotebookClient(notebook, km=kernel, timeout=120).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    assert [output for output in outputs if output.get("name") == "stderr"] == []
    texts = [output.get("text", "") for output in outputs]
    return "".join([*texts, *(output.get("data", {}).get("text/plain", "") for output in outputs)])


def test_look_at_an_env(kernel: KernelManager) -> None:
    told = execute(kernel, "env", overrides=QUICK)
    assert "'progress'" in told
    assert told.count("<Figure") == 4


def test_inspect_a_policy(kernel: KernelManager, tmp_path: Path) -> None:
    config = real_config(*QUICK, "model=sdfgcn")
    size = config.env.arena.image_size
    network = build_q_network(config.model, 8, 2, size, 0)
    save_policy(tmp_path, network, {})
    told = execute(kernel, "policy", checkpoint=str(tmp_path), overrides=QUICK)
    assert "'name': 'sdfgcn'" in told
    assert "'pushes': 4, 'success': False" in told  # untrained: it goes on to the limit
    assert told.count("<Figure") == 4


def test_read_results(kernel: KernelManager, tmp_path: Path) -> None:
    episodes = [
        EpisodeResult(i, i, 2, "mug;plate", i > 0, 7 + i, 20.0, i == 0, False, 5.0, 1.0)
        for i in range(3)
    ]
    with RunFolder(tmp_path / "run", compose_config(*QUICK), ["n_objects=2"]) as folder:
        folder.keep(episodes)
        folder.write_results({"model": "sdfgcn", "success_rate": 2 / 3})
        with (folder.path / "train.csv").open("w") as file:
            csv.writer(file).writerows([columns(), [0.5] * len(columns())])
    told = execute(kernel, "results", folders=[str(tmp_path)])
    assert "rule_based" in told
    assert "0.6666" in told
    assert "out of range" in told
    assert told.count("<Figure") == 2


def test_results_before_any_run(kernel: KernelManager, tmp_path: Path) -> None:
    assert "No run folders in" in execute(kernel, "results", folders=[str(tmp_path)])


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_stored(path: Path) -> None:
    """Of one run from top to bottom without a warning, and nothing of the machine it ran on."""
    notebook = json.loads(path.read_text())
    nbformat.validate(notebook)
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
    outputs = [output for cell in code for output in cell["outputs"]]
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 2
    assert {output.get("name") for output in outputs} <= {None, "stdout"}
    texts = [
        "".join([*output.get("text", ()), *content])
        for output in outputs
        for kind, content in {"": "", **output.get("data", {})}.items()
        if kind != "image/png"
    ]
    assert not re.search(r"(^|[\s'\"(])/(home|root|tmp|work|Users|usr)/", "\n".join(texts))
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}


def test_stored_outputs_are_small() -> None:
    assert sum(path.stat().st_size for path in NOTEBOOKS) < 1e6


def test_the_stored_episode_succeeds() -> None:
    assert "'success': True" in (ROOT / "notebooks" / "policy.ipynb").read_text()
