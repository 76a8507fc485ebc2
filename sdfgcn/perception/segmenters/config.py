"""Settings of `segmentation=ucn`, for its network and its clustering."""

from __future__ import annotations

from dataclasses import dataclass

from sdfgcn.config import SegmentationConfig, at_least, positive


@dataclass
class UCNConfig(SegmentationConfig):
    """Unseen object clustering (`conf/segmentation/ucn.yaml`)."""

    weights: str | None = None
    channels: int = at_least(1)
    widths: list[int] = at_least(1)
    embedding: int = at_least(1)
    table_distance: float = at_least(0)
    seeds: int = at_least(1)
    seed_distance: float = at_least(0)
    concentration: float = positive()
    iterations: int = at_least(0)
    merge_distance: float = at_least(0)
    part_gap: int = at_least(0)
    max_hole: int | None = at_least(0, default=None)
    min_pixels: int = at_least(0)
