"""A user's mesh file as a shape: cleaned, wound outwards, and cut into convex pieces.

Only `sdfgcn.objects.sources.shapenet` loads trimesh and CoACD, and passes them in.
"""

from __future__ import annotations

import hashlib
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import ConvexHull, QhullError

from sdfgcn.config import ObjectsConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.mesh_folder import MeshFile, shown
from sdfgcn.objects.model import Shape, name_generator
from sdfgcn.objects.storage import cache_dir, new_folder

BYTES_MAX = 2**29  # of a mesh file; a larger one would take minutes to read and fill the memory
SLIMMEST = 0.02  # width to length; after scaling, a slimmer needle would cover no pixel
NO_AREA = 1e-12  # of a face, the mesh's size being 1
NO_VOLUME = 1e-9  # of a convex piece, likewise


def read_mesh(file: MeshFile, cfg: ObjectsConfig, trimesh: ModuleType, coacd: ModuleType) -> Shape:
    """Read and decompose one mesh.

    Raises:
        SdfgcnError: The mesh cannot be read, or is no body that can be pushed.
    """
    try:
        mesh = _cleaned(_loaded(file, trimesh))
        mesh.faces = wound(np.asarray(mesh.vertices), np.asarray(mesh.faces), trimesh)
        vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)
        _check_sides(vertices)
        uv, texture = _texture(mesh, cfg.texture_size)
        pieces = _decomposed(vertices, faces, cfg.max_pieces, coacd)
    except Exception as error:  # trimesh's readers raise many kinds of errors
        raise SdfgcnError(
            f"The mesh {shown(file.path)} cannot be used ({_reason(error)})."
        ) from error
    # ShapeNet's meshes have no unit, so the size is drawn from the allowed range, seeded by name.
    footprint = name_generator(file.name).uniform(cfg.footprint_min, cfg.footprint_max)
    return Shape(vertices, faces, pieces, uv, texture, footprint)


def _reason(error: Exception) -> str:
    """What is wrong, in one line."""
    if isinstance(error, QhullError):
        return "it is flat"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return next(iter(str(error).splitlines()), "") or type(error).__name__


def _loaded(file: MeshFile, trimesh: ModuleType) -> Any:
    """The file as one `trimesh.Trimesh`, whose vertices and faces are numbers."""
    size = file.path.stat().st_size
    if shown(file.path) != str(file.path):
        raise ValueError("its path is no valid UTF-8, so rename it")
    if size == 0:
        raise ValueError("the file is empty")
    if size > BYTES_MAX:
        raise ValueError(
            f"the file has {size / 2**20:.0f} MiB, and at most {BYTES_MAX / 2**20:.0f} are read"
        )
    with file.path.open("rb"):  # so that a missing permission is named, whatever the reader does
        pass
    # Unprocessed: trimesh would drop what is not finite, and weld all of a tiny mesh.
    mesh = trimesh.load_scene(file.path, process=False).to_mesh()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if len(faces) == 0:
        raise ValueError("it has no faces")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError("its faces name vertices that it does not have")
    if not np.isfinite(vertices[faces]).all():
        raise ValueError("it has vertices that are not finite")
    return mesh


def _cleaned(mesh: Any) -> Any:
    """The mesh with a size of 1, without faces that are double or have no area."""
    mesh.remove_unreferenced_vertices()
    low, high = mesh.bounds
    size = float((high - low).max())
    if not 0 < size < np.inf:
        raise ValueError("all its vertices are in one place" if size == 0 else "it is too large")
    mesh.vertices = (np.asarray(mesh.vertices) - low) / size
    mesh.merge_vertices()
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mesh.update_faces((0.5 * np.linalg.norm(normals, axis=1) > NO_AREA) & mesh.unique_faces())
    if len(mesh.faces) == 0:
        raise ValueError("its faces have no area")
    mesh.remove_unreferenced_vertices()
    return mesh


def wound(vertices: NDArray, faces: NDArray, trimesh: ModuleType) -> NDArray[np.int64]:
    """The faces [F, 3], each turned over if need be, so that they agree and look outwards.

    Faces are neighbours if their corners are in the same places: at a texture seam, and in many
    files at every edge, they share no vertex. What is open has no outside; its faces agree only.
    """
    points, places = np.unique(vertices, axis=0, return_inverse=True)
    spots = places.ravel()[faces]
    welded = trimesh.Trimesh(points, spots, process=False)
    trimesh.repair.fix_normals(welded, multibody=True)
    turned = (np.asarray(welded.faces) != spots).any(axis=1)  # a turn reverses the corners
    return np.where(turned[:, None], faces[:, ::-1], faces)


def _check_sides(vertices: NDArray) -> None:
    """Refuse what is flat or a needle.

    Raises:
        ValueError: It is a needle.
        QhullError: It is flat.
    """
    points = vertices[ConvexHull(vertices).vertices]
    centred = points - points.mean(axis=0)
    axes = np.linalg.svd(centred, full_matrices=False)[2]
    length, width, _ = np.ptp(centred @ axes.T, axis=0)
    if width < SLIMMEST * length:
        raise ValueError(
            f"it is a needle, {length / width:.0f} times as long as wide; {1 / SLIMMEST:.0f} times "
            "would work"
        )


def _texture(mesh: Any, size: int) -> tuple[NDArray | None, NDArray[np.uint8] | None]:
    """The mesh's uv (with v flipped, see `ObjectModel`) and texture, or (None, None)."""
    material = getattr(mesh.visual, "material", None)
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    uv = getattr(mesh.visual, "uv", None)
    if image is None or uv is None or len(uv) != len(mesh.vertices) or not np.isfinite(uv).all():
        return None, None
    pixels = image.convert("RGB").resize((size, size), Image.Resampling.BOX)
    return np.column_stack([uv[:, 0], 1.0 - uv[:, 1]]), np.asarray(pixels)


def _decomposed(
    vertices: NDArray, faces: NDArray, max_pieces: int, coacd: ModuleType
) -> tuple[NDArray, ...]:
    """Convex pieces by CoACD, which takes seconds to minutes; cached by the mesh's content."""
    content = vertices.tobytes() + faces.tobytes() + str(max_pieces).encode()
    folder = cache_dir() / "decompositions" / hashlib.sha256(content).hexdigest()[:32]
    if not folder.is_dir():
        parts = coacd.run_coacd(
            coacd.Mesh(vertices, faces),
            threshold=0.08,  # allowed concavity; lower values give more, smaller pieces
            max_convex_hull=max_pieces,
            preprocess_resolution=30,
            mcts_iterations=60,
            seed=0,
        )
        # What CoACD cannot cut is taken as convex.
        found = [np.asarray(points) for points, _ in parts if _has_volume(np.asarray(points))]
        with new_folder(folder) as scratch:
            np.savez(scratch / "pieces.npz", *(found or [vertices]))
    try:
        with np.load(folder / "pieces.npz", allow_pickle=False) as stored:
            pieces = tuple(stored[key] for key in stored.files)
        if not (pieces and all(piece.shape == (len(piece), 3) for piece in pieces)):
            raise ValueError("not points")
        if not all(np.isfinite(piece).all() for piece in pieces):
            raise ValueError("not finite")
        return pieces
    except Exception as error:
        raise ValueError(
            f"its cached pieces in {folder} are damaged; delete that folder"
        ) from error


def _has_volume(points: NDArray) -> bool:
    try:
        return bool(ConvexHull(points).volume > NO_VOLUME)
    except (QhullError, ValueError):  # flat, or fewer than four points
        return False
