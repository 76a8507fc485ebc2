"""Settings of `segmentation=ucn`, for its network and its clustering."""

from __future__ import annotations

from dataclasses import dataclass

from sdfgcn.config import SegmentationConfig, fraction, number, positive, several


@dataclass
class UCNConfig(SegmentationConfig):
    """Unseen object clustering (`conf/segmentation/ucn.yaml`)."""

    weights: str | None = None
    channels: int = number(1, 4096)
    widths: list[int] = several(1, 4096)
    embedding: int = number(1, 4096)
    table_distance: float = fraction()
    seeds: int = number(1, 10_000)
    seed_distance: float = fraction()
    concentration: float = positive(1000)
    iterations: int = number(0, 10_000)
    merge_distance: float = fraction()
    part_gap: int = number(0, 1024)
    max_hole: int | None = number(0, 1_000_000, default=None)
    min_pixels: int = number(1, 1_000_000)
