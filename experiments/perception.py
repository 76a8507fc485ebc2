"""How well does perception see? Held-out objects in the environment's own scenes.

    python experiments/perception.py                         every section, 100 scenes a count
    python experiments/perception.py segmentation scenes=20

Writes `results/perception_<section>.json` and what else a section's module says.
"""

from __future__ import annotations

import os
import sys

os.environ.setdefault("MUJOCO_GL", "egl")

import perception_segmentation
from common import parse, save

SECTIONS = {"segmentation": perception_segmentation.measure}


def main() -> None:
    asked = [argument for argument in sys.argv[1:] if argument in SECTIONS]
    others = [argument for argument in sys.argv[1:] if argument not in SECTIONS]
    own, overrides = parse(others, {"scenes": 100})
    for section in asked or SECTIONS:
        save(f"perception_{section}", SECTIONS[section](overrides, own["scenes"]))


if __name__ == "__main__":
    main()
