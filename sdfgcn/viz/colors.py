"""Colours of recordings and films: of objects, and of how a push went."""

from __future__ import annotations

from sdfgcn.task.world import PushStatus

Color = tuple[int, int, int]

# Okabe and Ito's colour-blind-safe palette, by slot.
_PALETTE: tuple[Color, ...] = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
    (153, 153, 153),
)
UNMATCHED_COLOR: Color = (255, 0, 255)
STATUS_COLORS: dict[PushStatus, Color] = {
    "done": (40, 200, 80),
    "blocked": (230, 50, 50),
    "unreachable": (140, 140, 140),
    "no_contact": (240, 180, 40),
}


def slot_color(slot: int) -> Color:
    """The colour of an object in masks, outlines and plots."""
    return _PALETTE[slot % len(_PALETTE)]
