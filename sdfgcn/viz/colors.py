"""The colours of a recording: one for each object, and scales for distances and values."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from sdfgcn.envs.records import EpisodeStart
from sdfgcn.task.world import PushStatus

Color = tuple[int, int, int]

# Okabe and Ito's colour-blind-safe palette, for objects that have no one colour of their own.
_PALETTE: Final[tuple[Color, ...]] = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
    (153, 153, 153),
)
_DISTINCT = 40.0  # least distance of two objects' colours, of 442 from black to white
_BRIGHTEST = 160.0  # of 255, least of the largest component; darker ones cannot be read on black

UNMATCHED_COLOR: Final[Color] = (255, 0, 255)
EDGE_COLOR: Final[Color] = (160, 160, 160)  # between objects of one picture
MATCH_COLOR: Final[Color] = (255, 255, 255)  # from an object to its goal
ILLEGAL_COLOR: Final[Color] = (45, 45, 45)
STATUS_COLORS: Final[dict[PushStatus, Color]] = {
    "done": (60, 230, 90),
    "blocked": (255, 60, 60),
    "unreachable": (170, 170, 170),
    "no_contact": (255, 170, 30),
}

# From the zero contour to the largest distance; inside, from the contour to the deepest point.
_OUTSIDE: Final = ((224, 243, 248), (116, 173, 209), (49, 54, 149))
_INSIDE: Final = ((253, 174, 97), (215, 48, 39), (165, 0, 38))
_VALUES: Final = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))


def object_colors(episode: EpisodeStart) -> list[Color]:
    """The one colour of each object, by slot.

    It is the object's own if it has one and no earlier slot has nearly the same; the colours of
    textured objects, and of all objects of a world without truth, come from a palette.
    """
    colors: list[Color] = []
    for slot in range(episode.n_objects):
        own = _own_color(episode, slot)
        if own is None or not _is_new(own, colors):
            spare = [color for color in _PALETTE if _is_new(color, colors)]
            own = spare[0] if spare else _PALETTE[slot % len(_PALETTE)]
        colors.append(own)
    return colors


def _own_color(episode: EpisodeStart, slot: int) -> Color | None:
    truth = episode.truth
    if truth is None or truth.objects[slot].texture is not None:
        return None
    color = 255.0 * np.asarray(truth.colors[slot][:3])
    brightest = float(color.max())
    share = max(0.0, (_BRIGHTEST - brightest) / (255.0 - brightest + 1e-9))
    red, green, blue = np.round(color + share * (255.0 - color)).astype(int).tolist()
    return red, green, blue


def _is_new(color: Color, colors: list[Color]) -> bool:
    return all(np.linalg.norm(np.subtract(color, other)) >= _DISTINCT for other in colors)


def sdf_colors(sdf: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Signed distances [H, W] in colours [H, W, 3]: red inside, blue outside, pale at the contour.

    The scale is the same for all: it ends at half the height of the picture, on both sides, and is
    that of the square root, as objects are small.
    """
    share = np.sqrt(np.clip(np.abs(sdf) / (0.5 * sdf.shape[0]), 0.0, 1.0))
    share = np.round(64 * share) / 64  # fewer colours make smaller files
    inside = (sdf < 0.0)[..., None]
    return np.where(inside, _scale(share, _INSIDE), _scale(share, _OUTSIDE))


def value_colors(values: NDArray[np.floating], low: float, high: float) -> NDArray[np.uint8]:
    """Colours [..., 3] of values [...], from dark violet at `low` to yellow at `high`."""
    share = np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0)
    return _scale(share, _VALUES)


def _scale(share: NDArray[np.floating], stops: tuple[Color, ...]) -> NDArray[np.uint8]:
    places = np.linspace(0.0, 1.0, len(stops))
    channels = [np.interp(share, places, channel) for channel in zip(*stops, strict=True)]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)
