"""Drawing on the pictures of a film: outlines, labels, the push's arrow and captions."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import get_data_path
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from sdfgcn.viz.shapes import zero_contour

Color = tuple[int, int, int]

WHITE: Color = (255, 255, 255)
DIM: Color = (170, 170, 170)
STRIP: Color = (28, 28, 32)  # behind the captions
# Everything scales with the height of the whole frame.
_TEXT, _STRIP, _LINE = 1 / 26, 1 / 7, 1 / 160


@dataclass(frozen=True)
class Words:
    """A piece of a caption and its colour."""

    text: str
    color: Color = WHITE
    bold: bool = False


@functools.cache
def font(height: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """DejaVu Sans (which comes with Matplotlib and has arrows) for a frame `height` pixels high."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    size = max(9, round(height * _TEXT))
    return ImageFont.truetype(str(Path(get_data_path()) / "fonts" / "ttf" / name), size)


def picture_height(height: int) -> int:
    """How much of a frame's height the picture has; the captions take the rest."""
    return height - 2 * round(height * _STRIP / 2)


def with_captions(
    picture: Image.Image, height: int, lines: Sequence[tuple[Sequence[Words], Sequence[Words]]]
) -> Image.Image:
    """A frame of `height` pixels: the picture, and below it lines of words, left and right."""
    frame = Image.new("RGB", (picture.width, height), STRIP)
    frame.paste(picture)
    draw = ImageDraw.Draw(frame)
    room = (height - picture.height) / len(lines)
    margin = round(0.25 * room)
    for number, (left, right) in enumerate(lines):
        y = picture.height + round((number + 0.5) * room)
        end = picture.width - margin - sum(_widths(right, height))
        _write(draw, (margin, y), left, height)
        _write(draw, (end, y), right, height)
    return frame


def fitting(pieces: Sequence[Words], width: int, height: int) -> list[Words]:
    """As many pieces as fit into `width` pixels, then dots."""
    kept: list[Words] = []
    for piece in pieces:
        if sum(_widths([*kept, piece, Words(" …")], height)) > width and kept:
            return [*kept, Words(" …", DIM)]
        kept.append(piece)
    return kept


def _widths(pieces: Sequence[Words], height: int) -> list[float]:
    return [font(height, piece.bold).getlength(piece.text) for piece in pieces]


def _write(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], pieces: Sequence[Words], height: int
) -> None:
    x, y = at
    for piece, width in zip(pieces, _widths(pieces, height), strict=True):
        draw.text((x, y), piece.text, piece.color, font(height, piece.bold), anchor="lm")
        x += width


def outlines(masks: NDArray[np.bool_]) -> list[list[NDArray[np.float64]]]:
    """For each mask [H, W], the polylines [P, 2] around it, in pixels."""
    return [zero_contour(0.5 - np.pad(mask, 1).astype(np.float32)) for mask in masks]


def draw_outlines(
    picture: Image.Image, lines: Sequence[NDArray[np.float64]], color: Color, height: int
) -> None:
    """Draw polylines, as from `outlines`."""
    draw = ImageDraw.Draw(picture)
    width = max(1, round(height * _LINE * 0.7))
    for line in lines:
        draw.line([(u - 1.0, v - 1.0) for u, v in line], color, width, joint="curve")


def draw_label(
    picture: Image.Image, at: NDArray[np.float64], text: str, color: Color, height: int
) -> None:
    """Write a short text around a point, in black on a disc of the colour."""
    if not np.isfinite(at).all():
        return
    draw = ImageDraw.Draw(picture)
    u, v = at
    radius = 0.5 * height * _TEXT
    draw.ellipse([u - radius, v - radius, u + radius, v + radius], color, (0, 0, 0))
    draw.text((u, v), text, (0, 0, 0), font(round(0.65 * height), bold=True), anchor="mm")


def draw_title(picture: Image.Image, text: str, height: int) -> None:
    """Write a title at the top left."""
    if text:
        draw = ImageDraw.Draw(picture)
        edge = round(height * _TEXT / 2)
        large = font(round(1.25 * height), bold=True)
        draw.text((edge, edge), text, WHITE, large, stroke_width=2, stroke_fill=(0, 0, 0))


def draw_arrow(
    picture: Image.Image, start: NDArray, end: NDArray, color: Color, height: int
) -> None:
    """Draw an arrow between two points [2], in pixels, with a dark rim."""
    if not np.isfinite([start, end]).all():
        return
    along = end - start
    length = float(np.linalg.norm(along))
    if length < 1.0:
        return
    along /= length
    draw = ImageDraw.Draw(picture)
    width = height * _LINE
    for rim, shade in ((0.6 * width, (0, 0, 0)), (0.0, color)):
        draw.polygon([tuple(point) for point in _arrow(start, along, length, width, rim)], shade)


def _arrow(
    start: NDArray, along: NDArray, length: float, width: float, rim: float
) -> NDArray[np.float64]:
    """[7, 2] the corners of an arrow, grown by `rim` pixels."""
    across = np.array([-along[1], along[0]])
    head = min(4.0 * width, 0.6 * length)
    neck, tip, back = length - head - rim, length + 1.8 * rim, -rim
    half, wide = 0.5 * width + rim, 0.55 * head + 1.6 * rim
    corners = [(back, half), (neck, half), (neck, wide), (tip, 0.0)]
    corners += [(neck, -wide), (neck, -half), (back, -half)]
    return np.array([start + a * along + b * across for a, b in corners])


def side_by_side(frames: Sequence[Image.Image]) -> Image.Image:
    """Frames of the same size beside each other, with a thin gap."""
    gap = 2 * max(1, frames[0].width // 200)  # even, as MP4 wants
    width = sum(frame.width for frame in frames) + gap * (len(frames) - 1)
    joined = Image.new("RGB", (width, frames[0].height), WHITE)
    for number, frame in enumerate(frames):
        joined.paste(frame, (number * (frame.width + gap), 0))
    return joined
