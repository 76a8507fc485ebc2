"""The config of films (`conf/viz/video.yaml`)."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sdfgcn.config import VizConfig, at_least, fraction, one_of, positive, ranged, vector
from sdfgcn.errors import SdfgcnError

if TYPE_CHECKING:
    from sdfgcn.config import Config


@dataclass
class VideoConfig(VizConfig):
    """Format, size, pace, camera and looks of a film; see `conf/viz/video.yaml`."""

    format: str = one_of("mp4", "gif", "webp")
    width: int = ranged(lambda size: size >= 160 and size % 2 == 0, "must be even, from 160 on")
    height: int = ranged(lambda size: size >= 160 and size % 2 == 0, "must be even, from 160 on")
    fps: int = ranged(lambda rate: 1 <= rate <= 50, "must lie between 1 and 50")
    push_frames: int = at_least(1)
    jump_frames: int = at_least(0)
    hold: float = positive()
    quality: int = ranged(lambda value: 0 <= value <= 100, "must lie between 0 and 100")
    camera_azimuth: float = ranged(lambda angle: -360 <= angle <= 360, "must be in degrees")
    camera_elevation: float = ranged(lambda angle: 0 < angle < 90, "must lie between 0 and 90")
    camera_distance: float = positive()
    camera_fovy: float = ranged(lambda angle: 0 < angle < 180, "must lie between 0 and 180")
    camera_target: list[float] = vector(3)
    table_rgba: list[float] = vector(4)
    ghost_alpha: float = fraction()
    samples: int = at_least(0)
    shadows: int = at_least(0)

    def check(self, config: Config) -> None:
        """See `ComponentConfig`; a film must not fail for want of a package once it is played."""
        if self.format == "mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
            raise SdfgcnError(
                "viz.format is 'mp4', but the package imageio-ffmpeg is not installed: "
                "pip install -e '.[video]', or use viz.format=gif or webp."
            )
