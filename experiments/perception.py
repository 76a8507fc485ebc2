"""Accuracy of perception on held-out objects in the environment's own scenes.

    python experiments/perception.py                         every section
    python experiments/perception.py segmentation scenes=20
    python experiments/perception.py matching scenes=50 objects=household
    python experiments/perception.py page                    the main rows into docs/perception.md

Each section writes `results/perception_<section>.json`, `.md` (the same as a table) and `.png`
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
from common import parse

from sdfgcn.errors import SdfgcnError

SECTIONS = {"segmentation": perception_segmentation, "matching": perception_matching}


def main(arguments: Sequence[str]) -> int:
    names = [argument for argument in arguments if "=" not in argument]
    own, overrides = parse([a for a in arguments if "=" in a], {"scenes": 0})
    try:
        for name in names:
            if name not in (*SECTIONS, "page"):
                sections = ", ".join([*SECTIONS, "page"])
                raise SdfgcnError(f"There is no section '{name}'; there are {sections}.")
        torch.set_num_threads(1)
        for name in names or SECTIONS:
            if name == "page":
                perception_page.run()
            else:
                section = SECTIONS[name]
                section.run(overrides, own["scenes"] or section.SCENES)
    except SdfgcnError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
