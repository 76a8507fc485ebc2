"""Turn a source's shape into a catalogue entry: centre, settle, scale, thicken, weigh."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import QhullError
from scipy.spatial.transform import Rotation

from sdfgcn.config import ObjectsConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.convex import compound_volume_centroid, diameter, hull_vertices, merge_pieces
from sdfgcn.objects.meshes import decimate
from sdfgcn.objects.model import ObjectModel, Recipe, Shape, name_generator
from sdfgcn.objects.resting import Pose, find_rests, tipping_angle, to_rest


def prepare(recipe: Recipe, cfg: ObjectsConfig) -> ObjectModel:
    """Build one catalogue entry: the scaled object with its resting poses.

    Raises:
        SdfgcnError: The object never comes to rest, MuJoCo cannot simulate it, or one of its
            collision pieces is flat.
    """
    try:
        shape = _reduced(recipe.build(), cfg)
    except QhullError as error:
        raise SdfgcnError(f"The object {recipe.name} has a convex piece without volume.") from error
    first = _first_scale(shape, cfg)
    shape = shape.mapped(lambda points: points * first)
    for _ in range(3):
        try:
            poses = _poses(shape, cfg, name_generator(recipe.name))
        except ValueError as error:  # from MuJoCo, such as a mass below its least
            reason = " ".join(str(error).split())
            raise SdfgcnError(
                f"The object {recipe.name} cannot be simulated ({reason}); it may be too thin."
            ) from error
        if not poses:
            raise SdfgcnError(
                f"The object {recipe.name} never comes to rest within settle_seconds="
                f"{cfg.settle_seconds}; raise that value or leave the object out."
            )
        scale = _final_scale(poses, shape.footprint, 1.0 / first, cfg)
        thin = min(poses, key=lambda pose: pose.top)
        if thin.top * scale >= cfg.thickness_min:
            break
        shape = _thickened(shape, thin.down, 1.02 * cfg.thickness_min / (thin.top * scale))
    shape = shape.mapped(lambda points: points * scale)
    return _model(recipe, shape, _within_limits(poses, scale, cfg), scale, cfg)


def _reduced(shape: Shape, cfg: ObjectsConfig) -> Shape:
    """The shape centred on its centroid, within the limits on faces, pieces and vertices."""
    pieces = merge_pieces(shape.pieces, cfg.max_pieces)
    vertices, faces, uv = decimate(shape.vertices, shape.faces, shape.uv, cfg.max_faces)
    pieces = [hull_vertices(piece, cfg.max_piece_vertices) for piece in pieces]
    _, centroid = compound_volume_centroid(pieces)
    shape = replace(shape, vertices=vertices, faces=faces, uv=uv, pieces=tuple(pieces))
    return shape.mapped(lambda points: points - centroid)


def _thickened(shape: Shape, direction: NDArray, factor: float) -> Shape:
    """Stretch along one direction, because the gripper would slide over a paper-thin object.

    A linear map keeps convex pieces convex and the centroid at the origin.
    """
    stretch = np.eye(3) + (factor - 1.0) * np.outer(direction, direction)
    return shape.mapped(lambda points: points @ stretch)


def _first_scale(shape: Shape, cfg: ObjectsConfig) -> float:
    """A scale that brings the shape near its final size; resting poses hardly depend on it."""
    size = diameter(np.concatenate(shape.pieces))
    return float(np.clip(size, cfg.footprint_min, cfg.footprint_max)) / size


def _poses(shape: Shape, cfg: ObjectsConfig, rng: np.random.Generator) -> list[Pose]:
    solid = np.concatenate(shape.pieces)
    points = np.concatenate([solid, shape.vertices])
    poses = [
        _measured(rotation, probability, solid, points)
        for rotation, probability in find_rests(shape.pieces, cfg, rng)
    ]
    # An object standing on its narrow side topples when pushed and ends up in another pose.
    low = 2.0 * min((pose.height for pose in poses), default=0.0)
    return [
        pose
        for pose in poses
        if pose.height <= low or tipping_angle(pose.rotation.apply(solid)) >= cfg.settle_min_tilt
    ]


def _measured(rotation: Rotation, probability: float, solid: NDArray, points: NDArray) -> Pose:
    turned = rotation.apply(points)
    height = -float(rotation.apply(solid)[:, 2].min())
    return Pose(
        rotation=rotation,
        height=height,
        top=float(turned[:, 2].max()) + height,
        footprint=diameter(turned[:, :2]),
        radius=float(np.linalg.norm(turned[:, :2], axis=1).max()),
        probability=probability,
    )


def _final_scale(
    poses: list[Pose], wanted: float | None, natural: float, cfg: ObjectsConfig
) -> float:
    """The scale for the `wanted` footprint or the `natural` size, as far as the limits allow.

    If the limits conflict, `footprint_min` wins.
    """
    footprint = poses[0].footprint
    smallest = cfg.footprint_min / footprint
    scale = natural if wanted is None else wanted / footprint
    scale = min(scale, cfg.footprint_max / max(pose.footprint for pose in poses))
    scale = min(scale, cfg.height_max / max(pose.top for pose in poses))
    return max(scale, smallest)


def _within_limits(poses: list[Pose], scale: float, cfg: ObjectsConfig) -> list[Pose]:
    """Drop poses that are still too tall or too wide, but never the most probable one."""
    fits = [
        index == 0
        or (pose.top * scale <= cfg.height_max and pose.footprint * scale <= cfg.footprint_max)
        for index, pose in enumerate(poses)
    ]
    kept = [pose for pose, fit in zip(poses, fits, strict=True) if fit]
    total = sum(pose.probability for pose in kept)
    return [replace(pose, probability=pose.probability / total) for pose in kept]


def _model(
    recipe: Recipe, shape: Shape, poses: list[Pose], scale: float, cfg: ObjectsConfig
) -> ObjectModel:
    volume, _ = compound_volume_centroid(shape.pieces)
    return ObjectModel(
        name=recipe.name,
        category=recipe.category,
        split=recipe.split,
        vertices=shape.vertices.astype(np.float32),
        faces=shape.faces.astype(np.int32),
        uv=None if shape.uv is None else shape.uv.astype(np.float32),
        texture=shape.texture,
        pieces=tuple(piece.astype(np.float32) for piece in shape.pieces),
        mass=float(np.clip(volume * cfg.density, cfg.mass_min, cfg.mass_max)),
        rests=tuple(to_rest(pose, scale) for pose in poses),
    )
