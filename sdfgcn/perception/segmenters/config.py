"""The numbers of `segmentation=ucn`, for its network and for its clustering."""

from __future__ import annotations

from dataclasses import dataclass

from omegaconf import MISSING

from sdfgcn.config import SegmentationConfig


@dataclass
class UCNConfig(SegmentationConfig):
    """Unseen object clustering (`conf/segmentation/ucn.yaml`)."""

    weights: str | None = None
    channels: int = MISSING
    widths: list[int] = MISSING
    embedding: int = MISSING
    table_distance: float = MISSING
    seeds: int = MISSING
    seed_distance: float = MISSING
    concentration: float = MISSING
    iterations: int = MISSING
    merge_distance: float = MISSING
    part_gap: int = MISSING
    max_hole: int | None = None
    min_pixels: int = MISSING
