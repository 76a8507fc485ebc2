"""Building blocks of a rerun recording: arrows for values and displacements."""

from __future__ import annotations

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from sdfgcn.task.camera import CameraModel
from sdfgcn.viz.colors import Color, value_colors
from sdfgcn.viz.shapes import circle

# Metres on the table: where the arrows of values begin, and the lengths of the worst and the best.
_CLEAR, _SHORT, _LONG = 0.012, 0.008, 0.06
SEEN_MOVE = 0.002  # metres; shorter displacements are not drawn
WHITE: Color = (255, 255, 255)


def values_2d(
    centers: NDArray[np.floating],
    values: NDArray[np.floating],
    legal: NDArray[np.bool_],
    chosen: tuple[int, int],
    limits: tuple[float, float],
    camera: CameraModel,
    height: float,
) -> rr.Arrows2D:
    """An arrow for each legal push around its object: longer is better, the chosen one is white.

    Args:
        centers: [m, 2] of the objects on the table, metres.
        values: [m, D] the value of each push.
        legal: [m, D] which are legal.
        chosen: Row and direction of the push.
        limits: Values at the ends of the colour scale.
        camera: The camera of the picture.
        height: Of the plane with the arrows, metres.
    """
    rows, directions = np.nonzero(legal)
    shown = values[rows, directions]
    spread = float(np.ptp(shown)) if len(shown) else 0.0
    share = (shown - shown.min(initial=np.inf)) / max(spread, 1e-9)
    angles = 2.0 * np.pi * directions / values.shape[1]
    ahead = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    begin = centers[rows] + _CLEAR * ahead
    end = begin + (_SHORT + share * (_LONG - _SHORT))[:, None] * ahead
    is_chosen = (rows == chosen[0]) & (directions == chosen[1])
    colors = np.where(is_chosen[:, None], WHITE, value_colors(shown, *limits))
    return _arrows(begin, end, colors, np.where(is_chosen, 0.8, 0.5), camera, height, order=25)


def moves_2d(
    centers: NDArray[np.floating],
    displacement: NDArray[np.floating],
    colors: list[Color],
    camera: CameraModel,
    height: float,
) -> rr.Arrows2D:
    """Displacements [m, 2] of objects at [m, 2] in the picture, metres, on a dark edge."""
    ends, edge = centers + displacement, np.zeros((len(centers), 3), dtype=np.uint8)
    return _arrows(
        np.concatenate([centers, centers]),
        np.concatenate([ends, ends]),
        np.concatenate([edge, np.reshape(colors, (-1, 3)).astype(np.uint8)]),
        np.repeat([0.9, 0.5], len(centers)),
        camera,
        height,
        order=35,
    )


def rings_2d(
    ends: NDArray[np.floating], radii: NDArray[np.floating], camera: CameraModel, height: float
) -> rr.LineStrips2D:
    """Circles on the table in the picture: standard deviations [m] about points [m, 2], metres."""
    rings = [
        camera.project(np.column_stack([circle(end, radius), np.full(25, height)]))
        for end, radius in zip(ends, radii, strict=True)
    ]
    return rr.LineStrips2D(rings, colors=WHITE, radii=0.25, draw_order=34)


def moves_3d(
    origins: NDArray[np.floating], displacement: NDArray[np.floating], colors: list[Color]
) -> rr.Arrows3D:
    """Displacements [m, 2] on the table of objects, above points [m, 3], metres."""
    vectors = np.column_stack([displacement, np.zeros(len(displacement))])
    return rr.Arrows3D(
        origins=origins, vectors=vectors, colors=np.reshape(colors, (-1, 3)), radii=0.003
    )


def _arrows(
    begin: NDArray[np.floating],
    end: NDArray[np.floating],
    colors: NDArray,
    radii: NDArray[np.floating],
    camera: CameraModel,
    height: float,
    order: float,
) -> rr.Arrows2D:
    """Arrows on the table, [m, 2] metres, in the picture."""
    heights = np.full(len(begin), height)
    origins = camera.project(np.column_stack([begin, heights]))
    tips = camera.project(np.column_stack([end, heights]))
    return rr.Arrows2D(
        origins=origins,
        vectors=tips - origins,
        colors=colors.astype(np.uint8),
        radii=radii,
        draw_order=order,
    )
