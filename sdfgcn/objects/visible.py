"""Whether a picture from above shows an object, and mending it if not.

The renderer does not draw the back of a face. A mesh that is wound the wrong way, or open like a
bowl without thickness, is then invisible in some poses, and an agent cannot solve its episodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.model import ObjectModel, Rest

FRONT_SHARE = 0.95  # of the area seen from above that faces turned upwards should cover
OUTLINE_SHARE = 0.5  # of the outline of the collision pieces that faces should cover
AREA_MIN = 2.5e-4  # m^2, about three pixels; a phone on its edge has 3e-4, and shows its side too


@dataclass(frozen=True)
class Areas:
    """Areas of an object in one pose, seen from above, square metres.

    Attributes:
        front: What faces turned upwards cover: what a picture shows.
        both: What faces cover, whichever way they are turned.
        outline: What the convex collision pieces cover: what it should show.
    """

    front: float
    both: float
    outline: float


def made_visible(model: ObjectModel) -> ObjectModel:
    """The object, with a back to each face if a picture would otherwise not show all of it.

    Raises:
        SdfgcnError: Its mesh has holes where its body is, or its outline is too narrow.
    """
    views = [areas(model, rest) for rest in model.rests]
    for seen in views:
        if seen.both < OUTLINE_SHARE * seen.outline:
            raise SdfgcnError(
                f"The object {model.name} cannot be seen from above: its faces cover "
                f"{1e4 * seen.both:.2f} of {1e4 * seen.outline:.2f} cm2 of its outline; close the "
                "holes of its mesh."
            )
        if seen.both < AREA_MIN:
            raise SdfgcnError(
                f"The object {model.name} cannot be seen from above: its outline has "
                f"{1e4 * seen.both:.2f} cm2, and at least {1e4 * AREA_MIN:.1f} would work; use a "
                "wider mesh or raise env.objects.footprint_min."
            )
    if all(seen.front >= FRONT_SHARE * seen.both for seen in views):
        return model
    return two_sided(model)


def areas(model: ObjectModel, rest: Rest) -> Areas:
    """The areas in one resting pose."""
    turn = Rotation.from_quat(rest.quat, scalar_first=True)
    corners = turn.apply(model.vertices)[:, :2][model.faces]
    ahead, aside = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    facing = ahead[:, 0] * aside[:, 1] - ahead[:, 1] * aside[:, 0]  # twice the area, up is positive
    pieces = [shapely.convex_hull(shapely.multipoints(turn.apply(p)[:, :2])) for p in model.pieces]
    return Areas(
        front=_covered(shapely.polygons(corners[facing > 0])),
        both=_covered(shapely.polygons(corners[facing != 0])),
        outline=_covered(np.array(pieces)),
    )


def two_sided(model: ObjectModel) -> ObjectModel:
    """The object with every face also turned over.

    The backs have vertices of their own, since a vertex of both has no normal.
    """
    n = len(model.vertices)
    return replace(
        model,
        vertices=np.concatenate([model.vertices, model.vertices]),
        faces=np.concatenate([model.faces, model.faces[:, ::-1] + n]).astype(np.int32),
        uv=None if model.uv is None else np.concatenate([model.uv, model.uv]),
    )


def _covered(shapes: NDArray) -> float:
    """The area of the union, square metres."""
    return float(shapely.union_all(shapes, grid_size=1e-6).area)
