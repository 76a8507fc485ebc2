"""The segmentation section of `perception.py`: scores the masks found against the renderer's.

Besides the JSON, writes `perception_segmentation.md`, the same as a table, and
`perception_segmentation.png`: pictures, true masks and found masks of the first and the
worst scenes.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from common import load, save
from numpy.typing import NDArray
from pictures import Picture, enlarged, painted, save_png, sheet, titled
from tqdm import tqdm

from sdfgcn.config import Config
from sdfgcn.evaluation.report import percent
from sdfgcn.evaluation.results import wilson
from sdfgcn.files import write_text
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.perception.segmenters.ucn import SHIPPED
from sdfgcn.provenance import provenance
from sdfgcn.registry import SEGMENTERS
from sdfgcn.segmentation.metrics import MaskScores, score_masks
from sdfgcn.segmentation.scores import Example, shifted_look, summary, views

SCENES = 100  # of each number of objects
N_OBJECTS = (2, 3, 4, 5, 6)
LOOKS = {"own": None, "shifted": shifted_look}  # light and table colour
CATALOGUES = ("scanned", "household")

Row = tuple[Example, NDArray[np.bool_], MaskScores]


def run(overrides: list[str], scenes: int, folder: Path) -> None:
    """Score every catalogue in every look, with `scenes` scenes per number of objects."""
    table, rows_of, seconds = [], {}, []
    for objects in CATALOGUES:
        config = load([*overrides, f"objects={objects}", "robot=gripper", "eval.split=test"])
        for look in LOOKS:
            rows = list(segmented(config, look, scenes, seconds))
            rows_of[objects, look] = rows
            for n in (*N_OBJECTS, None):
                chosen = [scores for view, _, scores in rows if n in (view.n_objects, None)]
                table.append(
                    {"objects": objects, "look": look, "n_objects": n or "2 to 6",
                     "scenes": len(chosen), **summary(chosen),
                     "count_right_ci95": counted(chosen)}
                )  # fmt: skip
    settings = config.env.perception.segmentation
    weights = Path(settings.weights or SHIPPED)
    result = {
        "split": "test",
        "overrides": overrides,
        "seeds": [0, scenes - 1],
        "weights_sha256": hashlib.sha256(weights.read_bytes()).hexdigest(),
        "hidden_objects": {
            f"{objects} {look}": sum(view.n_objects - len(view.masks) for view, _, _ in rows)
            for (objects, look), rows in rows_of.items()
        },
        "cpu_ms_a_picture": {
            "median": float(1e3 * np.median(seconds)),
            "p90": float(1e3 * np.quantile(seconds, 0.9)),
            "torch_threads": 1,
        },
        **provenance(),
        "rows": table,
    }
    save(folder, "perception_segmentation", result)
    write_text(folder / "perception_segmentation.md", markdown(result["rows"]))
    save_png(folder / "perception_segmentation.png", figure(rows_of))


def counted(scores: Sequence[MaskScores]) -> tuple[float, float]:
    """Wilson's 95% interval of the share of scenes with the right number of masks."""
    return wilson(sum(each.found == each.true for each in scores), len(scores))


def segmented(config: Config, look: str, scenes: int, seconds: list[float]) -> Iterator[Row]:
    """Yield each scene with the masks found; append the CPU time of each to `seconds`."""
    settings = config.env.perception.segmentation
    segment = SEGMENTERS.find(settings.name)(settings)
    catalogue = load_catalogue(config.env.objects, "test")
    for view in tqdm(
        views(config.env, catalogue, N_OBJECTS, scenes, LOOKS[look]),
        total=len(N_OBJECTS) * scenes,
        desc=f"{config.env.objects.name}, {look} look",
        unit="scene",
    ):
        start = time.process_time()
        masks = segment(view.pixels)
        seconds.append(time.process_time() - start)
        yield view, masks, score_masks(masks, view.masks)


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as a Markdown table, with Wilson's 95% intervals in brackets."""
    lines = [
        "| objects | light and table | n objects | scenes | overlap F | boundary F | count right |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {row['objects']} | {row['look']} | {row['n_objects']} | {row['scenes']} | "
        f"{row['overlap_f']:.3f} | {row['boundary_f']:.3f} | "
        f"{percent(row['count_right'], row['count_right_ci95'])} |"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def examples(rows: Sequence[Row], each: int = 6) -> list[Row]:
    """The first scenes with the most objects, and the scenes with the worst overlap."""
    most = [row for row in rows if row[0].n_objects == max(N_OBJECTS)]
    return [*most[:each], *sorted(rows, key=lambda row: row[2].overlap.f)[:each]]


def figure(rows_of: Mapping[tuple[str, str], Sequence[Row]], scale: int = 2) -> Picture:
    """Picture, true masks and found masks of each example, one above the other.

    A line for each catalogue and look: the first scenes with the most objects, then the worst.
    """
    lines = []
    for (objects, look), rows in rows_of.items():
        tiles = []
        for view, masks, scores in examples(rows):
            looks = (view.pixels, painted(view.pixels, view.masks), painted(view.pixels, masks))
            title = f"{view.n_objects} objects, F {scores.overlap.f:.2f}"
            tiles.append(titled(enlarged(np.vstack(looks), scale), title))
        line = sheet(tiles, columns=len(tiles), gap=2)
        about = "picture, true masks, found masks; first scenes, then the worst overlap F"
        lines.append(titled(line, f"{objects}, {look} light and table: {about}"))
    return sheet(lines, columns=1)
