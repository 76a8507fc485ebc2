"""Shared by the figures of `perception.py`: colours, painted or outlined masks, and sheets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from sdfgcn.files import replaced

Picture = NDArray[np.uint8]

RED = (230, 60, 60)
COLOURS = np.array(
    [RED, [60, 200, 60], [70, 110, 250], [240, 220, 40], [220, 80, 220], [60, 220, 220],
     [250, 150, 40], [250, 250, 250], [150, 150, 150], [120, 80, 40]], dtype=np.uint8
)  # fmt: skip
OUTLINE = 3  # pixels of the enlarged picture


def painted(pixels: Picture, masks: NDArray[np.bool_]) -> Picture:
    """[H, W, 3] the darkened picture with each mask in its own colour."""
    picture = pixels // 3
    for k, mask in enumerate(masks):
        picture[mask] = COLOURS[k % len(COLOURS)]
    return picture


def enlarged(pixels: NDArray, scale: int) -> NDArray:
    """Each pixel of [H, W, ...] as a square of `scale` pixels."""
    return pixels.repeat(scale, axis=0).repeat(scale, axis=1)


def outlined(
    pixels: Picture,
    masks: NDArray[np.bool_],
    matches: Sequence[int],
    wrong: Sequence[bool],
    scale: int,
) -> Picture:
    """Enlarge a picture, outline masks in the colour of their match, frame mistakes in red.

    Args:
        pixels: [H, W, 3].
        masks: [m, H, W].
        matches: [m] index of each mask's match, -1 for none.
        wrong: [m] whether the match is wrong.
        scale: Factor of enlargement.
    """
    picture = enlarged(pixels, scale).copy()
    for mask, match in zip(masks, matches, strict=True):
        if match >= 0:
            large = enlarged(mask, scale)
            outline = ndimage.binary_dilation(large, iterations=OUTLINE) & ~large
            picture[outline] = COLOURS[1 + match % (len(COLOURS) - 1)]  # red is for mistakes
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for mask in masks[np.asarray(wrong, dtype=bool)]:
        rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
        low, high = (columns[0] - 2, rows[0] - 2), (columns[-1] + 3, rows[-1] + 3)
        corners = [(scale * int(u), scale * int(v)) for u, v in (low, high)]
        pen.rectangle(corners, outline=RED, width=OUTLINE)
    return np.asarray(image)


def titled(picture: Picture, title: str, height: int = 22) -> Picture:
    """The picture below a line of text."""
    image = Image.new("RGB", (picture.shape[1], picture.shape[0] + height), "white")
    image.paste(Image.fromarray(picture), (0, height))
    ImageDraw.Draw(image).text((4, 2), title, fill="black", font=ImageFont.load_default(14))
    return np.asarray(image)


def sheet(tiles: Sequence[Picture], columns: int, gap: int = 0) -> Picture:
    """Arrange tiles of one size in rows, on white."""
    height, width = tiles[0].shape[:2]
    lines = -(-len(tiles) // columns)
    paper = np.full((lines * (height + gap), columns * (width + gap), 3), 255, dtype=np.uint8)
    for k, tile in enumerate(tiles):
        row, column = divmod(k, columns)
        top, left = row * (height + gap), column * (width + gap)
        paper[top : top + height, left : left + width] = tile
    return paper


def save_png(file: Path, picture: Picture) -> None:
    """Write a picture atomically."""
    with replaced(file) as part:
        Image.fromarray(picture).save(part, optimize=True)
