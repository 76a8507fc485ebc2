"""Building blocks of a rerun recording: archetypes of what the world and the pictures show."""

from __future__ import annotations

import io

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from PIL import Image

from sdfgcn.envs.records import Snapshot
from sdfgcn.objects.model import ObjectModel
from sdfgcn.task.camera import CameraModel
from sdfgcn.task.world import PushStatus, RobotLink
from sdfgcn.viz.colors import EDGE_COLOR, MATCH_COLOR, STATUS_COLORS, Color, sdf_colors
from sdfgcn.viz.shapes import edge_strips, vertex_normals

ColorLike = tuple[int, ...] | NDArray[np.uint8]

MASK_OPACITY = 0.35
GOAL_ALPHA = 90  # of 255


def png(pixels: NDArray[np.uint8]) -> rr.EncodedImage:
    """A picture, uint8 [H, W, 3], as a PNG."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="png", optimize=True)
    return rr.EncodedImage(contents=buffer.getvalue(), media_type="image/png")


def markdown(text: str) -> rr.TextDocument:
    """A text in Markdown."""
    return rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)


def sdf_image(sdf: NDArray[np.float32]) -> rr.EncodedImage:
    """A signed distance field, [H, W] pixels, in colours; see `sdf_colors`."""
    return png(sdf_colors(sdf))


def arrow_2d(start: NDArray, end: NDArray, status: PushStatus) -> rr.Arrows2D:
    """A push in the picture, with a dark edge; start and end are [2] pixels."""
    return rr.Arrows2D(
        origins=[start, start],
        vectors=[end - start, end - start],
        colors=[(0, 0, 0), STATUS_COLORS[status]],
        radii=[1.6, 1.0],
        labels=["", status.replace("_", " ")],
        show_labels=False,  # the colour suffices, and a label would cover objects
        draw_order=30,
    )


def arrow_3d(start: NDArray, end: NDArray, status: PushStatus) -> rr.Arrows3D:
    """A push in the world; start and end are [3] metres."""
    return rr.Arrows3D(
        origins=[start],
        vectors=[end - start],
        colors=STATUS_COLORS[status],
        radii=0.004,
        labels=status.replace("_", " "),
        show_labels=status != "done",
    )


def edges_2d(scene: Snapshot, goal: Snapshot) -> rr.LineStrips2D:
    """The scene graph's edges in the current picture: between objects, and to their goals."""
    strips, to_goal = edge_strips(scene, goal)
    colors = np.where(to_goal[:, None], MATCH_COLOR, EDGE_COLOR)
    return rr.LineStrips2D(list(strips), colors=colors.astype(np.uint8), radii=0.15, draw_order=15)


def outlines_2d(strips: list[NDArray], colors: list[Color], radius: float) -> rr.LineStrips2D:
    """Lines [P, 2] pixels in the picture, each on a dark one that is wider."""
    return rr.LineStrips2D(
        [*strips, *strips],
        colors=[(0, 0, 0)] * len(strips) + colors,
        radii=[1.8 * radius] * len(strips) + [radius] * len(strips),
        draw_order=20,
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


def link(part: RobotLink) -> rr.Mesh3D:
    """A link of the robot, in its frame."""
    return rr.Mesh3D(
        vertex_positions=part.vertices,
        triangle_indices=part.faces,
        vertex_normals=vertex_normals(part.vertices, part.faces),
        vertex_colors=part.colors,
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
