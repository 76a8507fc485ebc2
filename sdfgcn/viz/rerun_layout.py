"""The viewer's layout of a recording, for a window of 1600 x 1000 and larger."""

from __future__ import annotations

import numpy as np
import rerun.blueprint as rrb

from sdfgcn.config import ArenaConfig
from sdfgcn.viz.heat_map import CELL, NAMES

PUSHES = "push"
MOTION = "motion"
FEW = 3  # objects up to which all SDFs are seen at once


def blueprint(
    arena: ArenaConfig, n_objects: int, n_directions: int, with_values: bool, with_scores: bool
) -> rrb.Blueprint:
    """Pictures on the left, 3D view in the middle, SDFs on the right, figures and words below.

    Args:
        arena: Where to look.
        n_objects: Objects in the episode.
        n_directions: Push directions.
        with_values: Whether there are action values.
        with_scores: Whether there are scores of an explanation.
    """
    top = rrb.Horizontal(
        _pictures(), world_view(arena), _sdfs(n_objects), column_shares=[1.0, 1.35, 1.0]
    )
    values = [_values(n_objects, n_directions, with_scores)] if with_values else []
    bottom = rrb.Horizontal(
        _plots(), *values, _words(), column_shares=[1.0, *([1.5] * with_values), 1.1]
    )
    return rrb.Blueprint(
        rrb.Vertical(top, bottom, row_shares=[2.4, 1]),
        rrb.TimePanel(state="collapsed", timeline=PUSHES, fps=2.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _pictures() -> rrb.Vertical:
    """The decision large; what it was based on below."""
    seen = ("picture", "masks", "graph", "goal")
    chosen = ("picture", "values", "push", "expected/**", "moved", "names")
    return rrb.Vertical(
        _picture("Push and values of all pushes", "world/camera", chosen),
        rrb.Horizontal(
            _picture("Seen, and goals", "world/camera", seen),
            _picture("Goal", "goal", ("picture", "masks")),
        ),
        row_shares=[1.6, 1],
    )


def _picture(name: str, origin: str, parts: tuple[str, ...]) -> rrb.Spatial2DView:
    contents = [f"+ $origin/{part}" for part in parts]
    return rrb.Spatial2DView(origin=origin, contents=["+ $origin", *contents], name=name)


def _sdfs(n_objects: int) -> rrb.Container:
    slots = range(n_objects)
    if n_objects <= FEW:
        return rrb.Vertical(
            *(rrb.Horizontal(_sdf("scene", slot), _sdf("goal", slot)) for slot in slots)
        )
    return rrb.Tabs(
        *(
            rrb.Grid(
                *(_sdf(which, slot) for slot in slots),
                grid_columns=2,
                name=f"SDFs of the {which}",
            )
            for which in ("scene", "goal")
        )
    )


def _sdf(which: str, slot: int) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(origin=f"sdf/{which}/{slot}", name=f"SDF #{slot} {which}")


def _plots() -> rrb.Tabs:
    """Legends would cover lines; distances have the objects' colours, and words name the terms."""
    none, corner = rrb.PlotLegend(visible=False), rrb.PlotLegend("LeftTop")
    return rrb.Tabs(
        rrb.TimeSeriesView(
            origin="distance",
            name="Distance to goal (m)",
            plot_legend=none,
        ),
        rrb.TimeSeriesView(
            origin="reward", contents="+ reward/total", name="Reward", plot_legend=none
        ),
        rrb.TimeSeriesView(
            origin="reward", contents="+ reward/terms/**", name="Its terms", plot_legend=none
        ),
        rrb.TimeSeriesView(origin="outcome", name="Return", plot_legend=corner),
    )


def _values(n_objects: int, n_directions: int, with_scores: bool) -> rrb.Tabs:
    width, height = NAMES + n_directions * CELL[0], (n_objects + 2) * CELL[1]
    heat_map = rrb.Spatial2DView(
        origin="q_values/heat_map",
        name="Values",
        visual_bounds=rrb.VisualBounds2D(x_range=(0, width + 4), y_range=(0, height)),
    )
    table = rrb.TextDocumentView(origin="q_values/table", name="Table")
    scores = rrb.TextDocumentView(origin="expected/scores", name="Best pushes")
    return rrb.Tabs(heat_map, table, *([scores] * with_scores))


def _words() -> rrb.Tabs:
    columns = rrb.TextLogColumns(text_log_columns=["Body"])
    return rrb.Tabs(
        rrb.TextDocumentView(origin="words", name="This push"),
        rrb.TextLogView(origin="log", name="Log", columns=columns),
        rrb.TextDocumentView(origin="summary", name="Summary"),
    )


def world_view(arena: ArenaConfig, origin: str = "world", name: str = "World") -> rrb.Spatial3DView:
    """The 3D view from the camera's side, so that left and right are nearly as in the pictures."""
    (x_low, x_high), (y_low, y_high) = arena.reach_x, arena.reach_y
    centre = np.array([(x_low + x_high) / 2, (y_low + y_high) / 2, 0.05])
    # From the right, as the arm stands at the near side.
    eye = centre + (y_high - y_low) * np.array([1.05, -0.95, 0.95])
    return rrb.Spatial3DView(
        origin=origin,
        contents=["+ $origin/**", "- $origin/camera/**", "+ $origin/camera"],
        name=name,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=centre),
    )
