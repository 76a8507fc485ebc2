"""Accuracy of perception on held-out objects in the environment's own scenes.

    python experiments/perception.py                         every section
    python experiments/perception.py segmentation scenes=20
    python experiments/perception.py matching scenes=50 objects=household
    python experiments/perception.py page                    prints the tables' main rows
    python experiments/perception.py page --publish          puts them into docs/perception.md

Each section writes `perception_<section>.json`, `.md` (the same as a table) and `.png`
(examples and failures); see its module. `scenes` is the number of scenes per number of objects, by
default 100 for segmentation and 500 for matching.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("LP_NUM_THREADS", "0")  # software OpenGL: render in this thread
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

from collections.abc import Sequence

import perception_matching
import perception_page
import perception_segmentation
import torch
from common import PUBLISH, parse, run

from sdfgcn.errors import SdfgcnError

SECTIONS = {"segmentation": perception_segmentation, "matching": perception_matching}


def main(arguments: Sequence[str]) -> int:
    return run(lambda: _run(arguments))


def _run(arguments: Sequence[str]) -> None:
    names = [each for each in arguments if "=" not in each and not each.startswith("-")]
    given = parse([each for each in arguments if each not in names], {"scenes": 0}, __doc__ or "")
    for name in names:
        if name not in (*SECTIONS, "page"):
            sections = ", ".join([*SECTIONS, "page"])
            raise SdfgcnError(f"There is no section '{name}'; there are {sections}.")
    torch.set_num_threads(1)
    for name in names or SECTIONS:
        if name != "page":
            section = SECTIONS[name]
            given.folder.mkdir(parents=True, exist_ok=True)
            section.run(given.overrides, given.own["scenes"] or section.SCENES, given.folder)
        elif PUBLISH in arguments:
            perception_page.run()
        else:
            print(perception_page.tables())


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
