"""Run the notebooks from top to bottom and keep their outputs: `python notebooks/execute.py`."""

from __future__ import annotations

import base64
import io
import os
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

HERE = Path(__file__).resolve().parent


def shrink(notebook: nbformat.NotebookNode) -> None:
    """Give each stored picture a palette, which makes it three times smaller."""
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if encoded := output.get("data", {}).get("image/png"):
                picture = Image.open(io.BytesIO(base64.b64decode(encoded))).convert("RGB")
                packed = io.BytesIO()
                picture.quantize(128).save(packed, "PNG", optimize=True)
                output.data["image/png"] = base64.b64encode(packed.getvalue()).decode()


def main(names: list[str]) -> None:
    """Execute the named notebooks, or all of them, in this folder."""
    os.environ["PYTHONPATH"] = os.pathsep.join(
        [str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    for path in [HERE / f"{name}.ipynb" for name in names] or sorted(HERE.glob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        client = NotebookClient(notebook, timeout=600, record_timing=False)
        client.execute(cwd=str(HERE))
        shrink(notebook)
        notebook.metadata.language_info = {"name": "python"}
        nbformat.write(notebook, path)
        print(f"Wrote {path.name}.")


if __name__ == "__main__":
    main(sys.argv[1:])
