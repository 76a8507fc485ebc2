"""Building blocks of a rerun recording: colours, archetypes and the viewer's layout."""

from __future__ import annotations

import io

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from PIL import Image

from sdfgcn.config import ArenaConfig
from sdfgcn.envs.records import Snapshot
from sdfgcn.objects.model import ObjectModel
from sdfgcn.task.camera import CameraModel
from sdfgcn.task.world import PushStatus
from sdfgcn.viz.colors import STATUS_COLORS, Color
from sdfgcn.viz.shapes import edge_strips, vertex_normals

TIMELINE = "push"

ColorLike = tuple[int, ...] | NDArray[np.uint8]

EDGE_COLOR: Color = (160, 160, 160)  # between objects of one picture
MATCH_COLOR: Color = (255, 255, 255)  # from an object to its goal
MASK_OPACITY = 0.35
GOAL_ALPHA = 90  # of 255
_SDF_RANGE = 24.0  # pixels from zero to either end of the colour map


def png(pixels: NDArray[np.uint8]) -> rr.EncodedImage:
    """A picture, uint8 [H, W, 3], as a PNG."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="png")
    return rr.EncodedImage(contents=buffer.getvalue(), media_type="image/png")


def sdf_image(sdf: NDArray[np.float32]) -> rr.DepthImage:
    """A signed distance field, [H, W] pixels, in a diverging colour map."""
    return rr.DepthImage(
        sdf.astype(np.float16),  # at most 0.03 pixels off, at half the size
        meter=1.0,
        colormap=rr.components.Colormap.CyanToYellow,
        depth_range=(-_SDF_RANGE, _SDF_RANGE),
    )


def arrow_2d(start: NDArray, end: NDArray, status: PushStatus) -> rr.Arrows2D:
    """A push in the picture; start and end are [2] pixels."""
    return rr.Arrows2D(
        origins=[start],
        vectors=[end - start],
        colors=STATUS_COLORS[status],
        radii=1.0,
        labels=status,
        show_labels=status != "done",  # the colour suffices, and a label would cover objects
        draw_order=30,
    )


def edges_2d(scene: Snapshot, goal: Snapshot) -> rr.LineStrips2D:
    """The scene graph's edges in the current picture: between objects, and to their goals."""
    strips, to_goal = edge_strips(scene, goal)
    colors = np.where(to_goal[:, None], MATCH_COLOR, EDGE_COLOR)
    return rr.LineStrips2D(list(strips), colors=colors.astype(np.uint8), radii=0.15, draw_order=15)


def arrow_3d(start: NDArray, end: NDArray, status: PushStatus) -> rr.Arrows3D:
    """A push in the world; start and end are [3] metres."""
    return rr.Arrows3D(
        origins=[start], vectors=[end - start], colors=STATUS_COLORS[status], radii=0.004
    )


def mesh(model: ObjectModel, color: ColorLike, skin: bool = False) -> rr.Mesh3D:
    """An object's mesh in one colour, or with its texture if `skin` is set and it has one."""
    textured = skin and model.texture is not None and model.uv is not None
    return rr.Mesh3D(
        vertex_positions=model.vertices,
        triangle_indices=model.faces,
        vertex_normals=vertex_normals(model.vertices, model.faces),
        vertex_texcoords=model.uv if textured else None,
        albedo_texture=model.texture if textured else None,
        albedo_factor=None if textured else color,
    )


def transform(pose: NDArray[np.float64]) -> rr.Transform3D:
    """A pose [7]: xyz in metres, quaternion w, x, y, z (rerun puts w last)."""
    w, x, y, z = pose[3:]
    return rr.Transform3D(translation=pose[:3], quaternion=rr.Quaternion(xyzw=[x, y, z, w]))


def pinhole(camera: CameraModel) -> rr.Pinhole:
    """The camera's frustum, with the image plane a fifth of the way to the table."""
    return rr.Pinhole(
        focal_length=camera.focal,
        width=camera.size,
        height=camera.size,
        camera_xyz=rr.ViewCoordinates.RUB,
        image_plane_distance=0.2 * float(camera.position[2]),
    )


def table(x: list[float], y: list[float]) -> rr.Mesh3D:
    """A grey rectangle just below the objects; x and y are [low, high] in metres."""
    return rr.Mesh3D(
        vertex_positions=[(u, v, -0.001) for u, v in _corners(x, y)],
        triangle_indices=[[0, 1, 2], [0, 2, 3]],
        vertex_normals=[[0, 0, 1]] * 4,
        albedo_factor=(70, 70, 75),
    )


def region(x: list[float], y: list[float], color: ColorLike) -> rr.LineStrips3D:
    """The outline of a rectangle on the table; x and y are [low, high] in metres."""
    corners = [(u, v, 0.0) for u, v in _corners(x, y)]
    return rr.LineStrips3D([[*corners, corners[0]]], colors=color, radii=0.001)


def _corners(x: list[float], y: list[float]) -> list[tuple[float, float]]:
    return [(x[0], y[0]), (x[1], y[0]), (x[1], y[1]), (x[0], y[1])]


def blueprint(arena: ArenaConfig, n_objects: int, with_q_values: bool) -> rrb.Blueprint:
    """Pictures on the left, 3D view in the middle, SDFs on the right, plots below."""
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin="world/camera", name="Scene"),
        rrb.Spatial2DView(origin="goal", name="Goal"),
    )
    sdfs = rrb.Grid(
        *(
            rrb.Spatial2DView(origin=f"sdf/{which}/{slot}", name=f"#{slot} {which}")
            for slot in range(n_objects)
            for which in ("scene", "goal")
        ),
        grid_columns=2 if n_objects <= 3 else 4,
        name="SDFs",
    )
    words = rrb.Tabs(
        rrb.TextLogView(
            origin="log", name="Log", columns=rrb.TextLogColumns(text_log_columns=["Body"])
        ),
        rrb.TextDocumentView(origin="summary", name="Summary"),
    )
    q_values = [_q_values_view()] if with_q_values else []
    figures = rrb.Horizontal(
        rrb.TimeSeriesView(origin="distance", name="Distance to goal (m)"),
        rrb.TimeSeriesView(origin="reward", name="Reward"),
        rrb.TimeSeriesView(origin="outcome", name="Return and outcome"),
        *q_values,
        words,
        column_shares=[1, 1, 1, *([2] * len(q_values)), 1],
    )
    top = rrb.Horizontal(pictures, world_view(arena), sdfs, column_shares=[2, 3, 2])
    return rrb.Blueprint(
        rrb.Vertical(top, figures, row_shares=[3, 1]),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, fps=2.0),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _q_values_view() -> rrb.Tabs:
    return rrb.Tabs(
        rrb.TextDocumentView(origin="q_values/table", name="Q-values"),
        rrb.TensorView(origin="q_values", name="Heat map"),
    )


def world_view(arena: ArenaConfig, origin: str = "world", name: str = "World") -> rrb.Spatial3DView:
    """The 3D view from the camera's side, so that left and right are as in the pictures."""
    (x_low, x_high), (y_low, y_high) = arena.reach_x, arena.reach_y
    centre = np.array([(x_low + x_high) / 2, (y_low + y_high) / 2, 0.0])
    eye = centre + (y_high - y_low) * np.array([0.2, -1.0, 0.8])
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=centre),
    )
