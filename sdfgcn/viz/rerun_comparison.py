"""One scene played by several agents, as one rerun recording.

The entities are those of `rerun_recorder`, below the title of each agent.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader

from sdfgcn.config import ArenaConfig, EnvConfig
from sdfgcn.files import replaced
from sdfgcn.viz.records import Episode
from sdfgcn.viz.rerun_layout import PUSHES, world_view
from sdfgcn.viz.rerun_recorder import RerunRecorder


def record_comparison(path: Path, env: EnvConfig, episodes: Mapping[str, Episode]) -> Path:
    """Record episodes side by side, push by push.

    Args:
        path: The file, whose suffix becomes .rrd.
        env: The environment of all episodes.
        episodes: The episode of each agent, by its title.

    Returns:
        The file.

    Raises:
        SdfgcnError: The recording cannot be written, or there are no pictures.
    """
    path = path.with_suffix(".rrd")
    path.parent.mkdir(parents=True, exist_ok=True)
    roots = {title: re.sub(r"[^\w.-]", "_", title) for title in episodes}
    with TemporaryDirectory() as folder, replaced(path) as part:
        stream = rr.RecordingStream(f"sdfgcn {', '.join(episodes)}")
        stream.save(part)
        stream.send_blueprint(_layout(env.arena, roots))
        for number, (title, (start, steps)) in enumerate(episodes.items()):
            alone = Path(folder) / f"{number}.rrd"
            with RerunRecorder(alone, env) as recorder:
                recorder.start(start)
                for step in steps:
                    recorder.step(step)
            stream.send_chunks(_below(roots[title], alone))
        stream.flush()
        stream.disconnect()
    return path


def _below(root: str, path: Path) -> Iterator[Chunk]:
    """The chunks of a recording, with their entities below `root`."""
    for chunk in RrdReader(path).store().stream():
        if not chunk.entity_path.startswith("/__"):  # properties of the recording as a whole
            inner = chunk.entity_path.strip("/")
            yield chunk.with_entity_path(f"/{root}/{inner}".rstrip("/"))


def _layout(arena: ArenaConfig, roots: Mapping[str, str]) -> rrb.Blueprint:
    """A column for each agent: the scene in 3D, the pictures, distances to the goals, the log."""
    columns = [
        rrb.Vertical(
            world_view(arena, f"{root}/world", title),
            rrb.Horizontal(
                rrb.Spatial2DView(origin=f"{root}/world/camera", name="Scene"),
                rrb.Spatial2DView(origin=f"{root}/goal", name="Goal"),
            ),
            rrb.Tabs(
                rrb.TimeSeriesView(origin=f"{root}/distance", name="Distance to goal (m)"),
                rrb.TextLogView(origin=f"{root}/log", name="Log"),
                rrb.TextDocumentView(origin=f"{root}/summary", name="Summary"),
            ),
            row_shares=[3, 2, 2],
        )
        for title, root in roots.items()
    ]
    return rrb.Blueprint(
        rrb.Horizontal(*columns),
        rrb.TimePanel(state="collapsed", timeline=PUSHES, fps=2.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
