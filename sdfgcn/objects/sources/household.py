"""Procedurally generated household objects: no download, identical on every machine."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from sdfgcn.config import ObjectsConfig
from sdfgcn.objects.model import Recipe, Shape, Source
from sdfgcn.objects.primitives import (
    arc_path,
    box,
    circle,
    ellipsoid,
    join,
    prism,
    rod,
    turned_solid,
    turned_vessel,
)
from sdfgcn.registry import OBJECTS

# ruff: noqa: D103 - each function below builds the object it is named after, lengths in metres


def straight(length: float, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """Return a straight path along x that starts at (x, y, z)."""
    return np.array([[x, y, z], [x + length, y, z]])


def bowl(radius: float, height: float) -> Shape:
    profile = [(0.5 * radius, 0.0), (0.87 * radius, 0.45 * height), (radius, height)]
    return turned_vessel(profile, wall=0.006, base=0.006)


def plate(radius: float, height: float) -> Shape:
    return turned_vessel([(0.55 * radius, 0.0), (radius, height)], wall=0.012, base=0.006)


def mug(radius: float, height: float) -> Shape:
    body = turned_vessel([(radius, 0.0), (radius, height)], wall=0.005, base=0.006)
    loop = rod(arc_path(0.35 * height, 90, -90, 5), 0.005).moved(x=radius - 0.003, z=0.5 * height)
    return join(body, loop)


def book(length: float, width: float, thickness: float) -> Shape:
    cover = box(length, width, 0.003)
    pages = box(length - 0.006, width - 0.005, thickness - 0.004).moved(y=0.002, z=0.002)
    spine = box(length, 0.004, thickness).moved(y=0.002 - width / 2)
    return join(cover, pages, cover.moved(z=thickness - 0.003), spine)


def brush(length: float, width: float) -> Shape:
    head = prism(circle(0.3 * length, 12, width / (0.6 * length)), 0.012).moved(z=0.02)
    bristles = box(0.42 * length, 0.6 * width, 0.022)
    handle = rod(straight(0.55 * length, x=0.25 * length, z=0.026), 0.007)
    return join(head, bristles, handle)


def ring(radius: float, thickness: float) -> Shape:
    return rod(arc_path(radius, 0, 360, 12), thickness, squash=0.8).turned("x", 90)


def jar(radius: float, height: float) -> Shape:
    shoulder = [(0.94 * radius, 0.0), (radius, 0.08 * height), (radius, 0.7 * height)]
    lid = [(0.7 * radius, 0.8 * height), (0.8 * radius, 0.8 * height), (0.8 * radius, height)]
    return turned_solid([*shoulder, *lid])


def remote(length: float, width: float) -> Shape:
    keys = [
        box(0.14 * length, 0.6 * width, 0.003).moved(x=(k - 1.5) * 0.2 * length, z=0.016)
        for k in range(4)
    ]
    return join(box(length, width, 0.016), *keys)


def mallet(length: float, head: float) -> Shape:
    handle = rod(straight(length), 0.008)
    block = rod(np.array([[0, -head / 2, 0], [0, head / 2, 0.0]]), 0.35 * head)
    return join(handle, block)


def spoon(length: float, width: float) -> Shape:
    scoop = ellipsoid(0.7 * width, 0.5 * width, 0.008)
    return join(scoop, rod(straight(length - 0.9 * width, x=0.4 * width), 0.005))


def soap(length: float, width: float) -> Shape:
    return ellipsoid(length / 2, width / 2, 0.016)


def tray(length: float, width: float, height: float = 0.022) -> Shape:
    side, end = box(length, 0.006, height), box(0.006, width, height)
    return join(
        box(length, width, 0.006),
        side.moved(y=0.003 - width / 2),
        side.moved(y=width / 2 - 0.003),
        end.moved(x=0.003 - length / 2),
        end.moved(x=length / 2 - 0.003),
    )


def candlestick(radius: float, height: float) -> Shape:
    foot = [(radius, 0.0), (radius, 0.008), (0.32 * radius, 0.016)]
    return turned_solid([*foot, (0.32 * radius, height), (0.6 * radius, height + 0.012)])


def cheese(length: float, width: float) -> Shape:
    return prism([(0, 0), (length, -width / 2), (1.08 * length, 0), (length, width / 2)], 0.04)


def spool(radius: float, height: float) -> Shape:
    lower = [(radius, 0.0), (radius, 0.008), (0.5 * radius, 0.008)]
    upper = [(0.5 * radius, height - 0.008), (radius, height - 0.008), (radius, height)]
    return turned_solid([*lower, *upper])


def wrench(length: float, jaw: float) -> Shape:
    handle = box(length - jaw, 0.4 * jaw, 0.012).moved(x=(length - jaw) / 2)
    root = box(0.5 * jaw, 1.4 * jaw, 0.014).moved(x=length - 0.9 * jaw)
    prong = box(0.7 * jaw, 0.4 * jaw, 0.014).moved(x=length - 0.4 * jaw)
    return join(handle, root, prong.moved(y=0.5 * jaw), prong.moved(y=-0.5 * jaw))


def cup(radius: float, height: float) -> Shape:
    return turned_vessel([(0.7 * radius, 0.0), (radius, height)], wall=0.005, base=0.006)


def bottle(radius: float, height: float) -> Shape:
    body = [(0.95 * radius, 0.0), (radius, 0.05 * height), (radius, 0.6 * height)]
    neck = [(0.4 * radius, 0.8 * height), (0.4 * radius, height)]
    return turned_solid([*body, *neck])


def pan(radius: float, handle: float) -> Shape:
    dish = turned_vessel([(0.85 * radius, 0.0), (radius, 0.022)], wall=0.005, base=0.005)
    return join(dish, rod(straight(handle, x=radius - 0.004, z=0.016), 0.006, squash=1.4))


def dumbbell(length: float, weight: float) -> Shape:
    block = prism(circle(weight, 6), 0.3 * length).turned("y", 90)
    bar = rod(straight(0.5 * length, x=0.25 * length), 0.4 * weight)
    return join(block, bar, block.moved(x=0.7 * length))


def spatula(length: float, width: float) -> Shape:
    wide, narrow = 0.5 * width, 0.35 * width
    reach = 0.4 * length
    blade = prism([(0, -wide), (reach, -narrow), (reach, narrow), (0, wide)], 0.008)
    return join(blade, rod(straight(0.62 * length, x=0.38 * length, z=0.006), 0.006))


def basket(length: float, width: float) -> Shape:
    bow = rod(arc_path(length / 2 - 0.004, 0, 180, 6), 0.005).moved(z=0.04)
    return join(tray(length, width, 0.045), bow)


def hourglass(radius: float, height: float) -> Shape:
    lower = [(radius, 0.0), (radius, 0.006), (0.85 * radius, 0.2 * height)]
    upper = [(0.85 * radius, 0.8 * height), (radius, height - 0.006), (radius, height)]
    return turned_solid([*lower, (0.2 * radius, 0.5 * height), *upper])


def car(length: float, width: float) -> Shape:
    wheel = prism(circle(0.012, 12), 0.01).turned("x", 90)
    wheels = [
        wheel.moved(x=x * length, y=y * width / 2 + 0.005, z=0.012)
        for x in (-0.3, 0.3)
        for y in (-1, 1)
    ]
    outline = [(-0.32, 0.0), (0.22, 0.0), (0.1, 0.02), (-0.25, 0.02)]
    cabin = prism([(x * length, z) for x, z in outline], 0.8 * width).turned("x", 90)
    body = box(length, width, 0.022).moved(z=0.008)
    return join(body, cabin.moved(y=0.4 * width, z=0.03), *wheels)


# Category -> the function that builds it, and the arguments (m) of its two variants.
TRAIN: dict[str, tuple[Callable[..., Shape], tuple[tuple[float, ...], ...]]] = {
    "bowl": (bowl, ((0.055, 0.040), (0.045, 0.045))),
    "plate": (plate, ((0.060, 0.016), (0.048, 0.014))),
    "mug": (mug, ((0.036, 0.080), (0.032, 0.060))),
    "book": (book, ((0.115, 0.080, 0.024), (0.090, 0.065, 0.034))),
    "brush": (brush, ((0.120, 0.040), (0.100, 0.048))),
    "ring": (ring, ((0.040, 0.009), (0.028, 0.007))),
    "jar": (jar, ((0.033, 0.075), (0.040, 0.055))),
    "remote": (remote, ((0.120, 0.038), (0.090, 0.045))),
    "mallet": (mallet, ((0.100, 0.060), (0.085, 0.048))),
    "spoon": (spoon, ((0.125, 0.040), (0.100, 0.034))),
    "soap": (soap, ((0.085, 0.055), (0.065, 0.050))),
    "tray": (tray, ((0.110, 0.065), (0.080, 0.080))),
    "candlestick": (candlestick, ((0.036, 0.070), (0.030, 0.045))),
    "cheese": (cheese, ((0.090, 0.060), (0.070, 0.080))),
    "spool": (spool, ((0.030, 0.055), (0.040, 0.035))),
    "wrench": (wrench, ((0.120, 0.030), (0.095, 0.036))),
}
TEST: dict[str, tuple[Callable[..., Shape], tuple[tuple[float, ...], ...]]] = {
    "cup": (cup, ((0.042, 0.085), (0.036, 0.060))),
    "bottle": (bottle, ((0.024, 0.100), (0.030, 0.090))),
    "pan": (pan, ((0.038, 0.050), (0.030, 0.055))),
    "dumbbell": (dumbbell, ((0.110, 0.026), (0.085, 0.022))),
    "spatula": (spatula, ((0.125, 0.055), (0.105, 0.045))),
    "basket": (basket, ((0.090, 0.060), (0.070, 0.070))),
    "hourglass": (hourglass, ((0.026, 0.080), (0.032, 0.065))),
    "car": (car, ((0.100, 0.045), (0.080, 0.050))),
}


def recipes(cfg: ObjectsConfig) -> list[Recipe]:
    """Return the recipes of all 32 train and 16 test objects."""
    return [
        Recipe(f"{category}_{number}", category, split, partial(draw, *measures))
        for split, table in (("train", TRAIN), ("test", TEST))
        for category, (draw, variants) in table.items()
        for number, measures in enumerate(variants, start=1)
    ]


OBJECTS.register("household")(Source(recipes))
