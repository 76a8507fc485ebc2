"""Films and recordings of one scene played by several agents."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from sdfgcn.config import EnvConfig, VizConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.viz.video_config import VideoConfig

if TYPE_CHECKING:
    from sdfgcn.viz.records import Episode

FILMED, RECORDED = ("video", "both"), ("rerun", "both")


def check_comparable(viz: VizConfig) -> None:
    """Check that `draw_comparison` can draw what the config asks for.

    Raises:
        SdfgcnError: It cannot.
    """
    if viz.episodes and viz.name not in (*FILMED, *RECORDED):
        raise SdfgcnError(
            f"viz is '{viz.name}', which cannot show agents side by side; use video, rerun or "
            "both, or viz=none."
        )


def draw_comparison(
    path: Path, env: EnvConfig, viz: VizConfig, episodes: Mapping[str, Episode]
) -> None:
    """Film the episodes side by side, record them side by side, or both, as `viz` says.

    Args:
        path: The file to write, without its suffix.
        env: The environment of all episodes.
        viz: What to draw, and how.
        episodes: The episode of each agent, by its title.

    Raises:
        SdfgcnError: A file cannot be written, or there are no pictures to show.
    """
    if viz.name in RECORDED:
        from sdfgcn.viz.rerun_comparison import record_comparison  # loads rerun

        record_comparison(path, env, episodes)
    if viz.name in FILMED:
        from sdfgcn.viz.video_comparison import film_comparison  # loads MuJoCo

        assert isinstance(viz, VideoConfig)
        film_comparison(path, env, viz, episodes)
