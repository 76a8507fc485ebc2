"""A heat map of the value of every push, as a picture that can be read without a legend."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from sdfgcn.viz.colors import ILLEGAL_COLOR, Color, value_colors

CELL = (64, 26)  # pixels, width and height
NAMES = 150  # pixels, width of the column of names
_LIGHT, _DARK = (235, 235, 235), (0, 0, 0)
_FONT = 14  # pixels


def heat_map(
    values: NDArray[np.floating],
    legal: NDArray[np.bool_],
    chosen: tuple[int, int],
    names: list[str],
    colors: list[Color],
    limits: tuple[float, float],
) -> NDArray[np.uint8]:
    """Draw the values; illegal pushes are grey, and the chosen one has a white frame.

    Args:
        values: [m, D] the value of each push.
        legal: [m, D] which pushes are legal.
        chosen: Row and direction of the push.
        names: [m] names of the rows.
        colors: [m] their colours.
        limits: Values at the ends of the colour scale.

    Returns:
        uint8 [(m + 2) * 26, 150 + D * 64, 3]: a row of directions, m rows, and one for the scale.
    """
    m, n_directions = values.shape
    width, height = CELL
    picture = Image.new("RGB", (NAMES + n_directions * width, (m + 2) * height))
    draw = ImageDraw.Draw(picture)
    fills = value_colors(values, *limits)
    for k in range(n_directions):
        _arrow(draw, _middle(-1, k), 2.0 * np.pi * k / n_directions)
    for row in range(m):
        place = (4, (row + 1.5) * height)
        draw.text(place, names[row][:20], fill=colors[row], font=_font(), anchor="lm")
        for k in range(n_directions):
            fill = _color(fills[row, k]) if legal[row, k] else ILLEGAL_COLOR
            draw.rectangle(_box(row, k), fill=fill)
            ink = _DARK if np.dot(fill, [0.299, 0.587, 0.114]) > 130 else _LIGHT
            text = f"{values[row, k]:.2f}" if legal[row, k] else "-"
            draw.text(_middle(row, k), text, fill=ink, font=_font(), anchor="mm")
    if chosen[0] < m:
        draw.rectangle(_box(*chosen), outline=(255, 255, 255), width=3)
    _draw_scale(draw, m, n_directions, limits)
    return np.asarray(picture)


def _draw_scale(
    draw: ImageDraw.ImageDraw, row: int, n_directions: int, limits: tuple[float, float]
) -> None:
    left, right = NAMES, NAMES + n_directions * CELL[0] - 1
    top, bottom = (row + 1.35) * CELL[1], (row + 1.65) * CELL[1]
    ramp = value_colors(np.arange(left, right + 1, dtype=float), left, right)
    for x in range(left, right + 1):
        draw.line([(x, top), (x, bottom)], fill=_color(ramp[x - left]))
    middle = (row + 1.5) * CELL[1]
    for x, value, anchor in ((left, limits[0], "lm"), (right, limits[1], "rm")):
        text, font = f"{value:.2f}", _font()
        box = draw.textbbox((x, middle), text, font=font, anchor=anchor)
        draw.rectangle((box[0] - 3, box[1] - 3, box[2] + 3, box[3] + 3), fill=(0, 0, 0))
        draw.text((x, middle), text, fill=_LIGHT, font=font, anchor=anchor)
    draw.text((4, middle), "scale of the episode", fill=(150, 150, 150), font=_font(), anchor="lm")


def _arrow(draw: ImageDraw.ImageDraw, middle: tuple[float, float], angle: float) -> None:
    """An arrow by lines: not every font has one. Angles are counter-clockwise."""
    ahead = np.array([np.cos(angle), -np.sin(angle)])
    side = np.array([-ahead[1], ahead[0]])
    tip, tail = middle + 9 * ahead, middle - 9 * ahead
    for end in (tail, tip - 6 * ahead + 5 * side, tip - 6 * ahead - 5 * side):
        draw.line([tuple(tip), tuple(end)], fill=_LIGHT, width=2)


def _box(row: int, k: int) -> tuple[int, int, int, int]:
    left, top = NAMES + k * CELL[0], (row + 1) * CELL[1]
    return left + 1, top + 1, left + CELL[0] - 2, top + CELL[1] - 2


def _middle(row: int, k: int) -> tuple[float, float]:
    return NAMES + (k + 0.5) * CELL[0], (row + 1.5) * CELL[1]


def _color(values: NDArray[np.uint8]) -> Color:
    red, green, blue = values.tolist()
    return red, green, blue


@functools.cache
def _font() -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(_FONT)
