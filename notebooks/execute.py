"""Run the notebooks from top to bottom and keep their outputs: `python notebooks/execute.py`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).resolve().parent


def main(names: list[str]) -> None:
    """Execute the named notebooks, or all of them, in this folder."""
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    for path in [HERE / f"{name}.ipynb" for name in names] or sorted(HERE.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        client = NotebookClient(notebook, timeout=600, record_timing=False)
        client.execute(cwd=str(HERE))
        notebook.metadata.language_info = {"name": "python"}
        nbformat.write(notebook, path)
        print(f"Wrote {path.name}.")


if __name__ == "__main__":
    main(sys.argv[1:])
