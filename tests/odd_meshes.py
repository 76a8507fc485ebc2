"""Odd mesh files: what people's folders hold, and what should become of each."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

Write = Callable[[Path], None]


def box(x: float = 1.0, y: float = 0.8, z: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    """A closed box, wound outwards: vertices [8, 3] and faces [12, 3]."""
    corners = np.array([[a, b, c] for a in (0.0, x) for b in (0.0, y) for c in (0.0, z)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array(
        [[a, b, c] for a, b, c, _ in sides] + [[a, c, d] for a, _, c, d in sides]
    )


def dome(segments: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """The upper half of a sphere, open below, without thickness, wound outwards."""
    rings = np.radians([0.0, 30.0, 60.0])
    turns = 2 * np.pi * np.arange(segments) / segments
    circle = np.column_stack([np.cos(turns), np.sin(turns)])
    points = [[*(np.cos(ring) * spot), np.sin(ring)] for ring in rings for spot in circle]
    faces = []
    for ring in range(len(rings) - 1):
        for k in range(segments):
            a, b = ring * segments + k, ring * segments + (k + 1) % segments
            faces += [[a, b, b + segments], [a, b + segments, a + segments]]
    top = len(points)
    last = (len(rings) - 1) * segments
    faces += [[last + k, last + (k + 1) % segments, top] for k in range(segments)]
    return np.array([*points, [0.0, 0.0, 1.0]]), np.array(faces)


def obj(vertices: np.ndarray, faces: np.ndarray, before: str = "", end: str = "\n") -> Write:
    """An OBJ file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices, float).tolist()]
    lines += ["f " + " ".join(str(k + 1) for k in face) for face in faces]
    return text(before + end.join(lines) + end)


def stl(vertices: np.ndarray, faces: np.ndarray, count: int | None = None, cut: int = 0) -> Write:
    """A binary STL file; `count` is what its header says, `cut` the bytes missing at the end."""
    body = b"".join(
        struct.pack("<12fH", 0, 0, 0, *vertices[face].ravel(), 0) for face in np.asarray(faces)
    )
    content = bytes(80) + struct.pack("<I", len(faces) if count is None else count) + body
    return data(content[: len(content) - cut])


def glb(*bodies: tuple[np.ndarray, np.ndarray], length: int | None = None, cut: int = 0) -> Write:
    """A GLB file with a node for each body; `length` is what its header says."""
    import trimesh

    scene = trimesh.Scene([trimesh.Trimesh(*body, process=False) for body in bodies])
    content = scene.export(file_type="glb")
    if length is not None:
        content = content[:8] + struct.pack("<I", length) + content[12:]
    return data(content[: len(content) - cut])


def text(content: str) -> Write:
    """A file with a text."""
    return lambda path: path.write_bytes(content.encode()) and None


def data(content: bytes) -> Write:
    """A file with bytes."""
    return lambda path: path.write_bytes(content) and None


def link(target: str) -> Write:
    """A link."""
    return lambda path: path.symlink_to(target)


def unreadable(path: Path) -> None:
    """A good mesh that nobody may read."""
    obj(*box())(path)
    path.chmod(0)


def sparse(path: Path) -> None:
    """A file of a gibibyte that takes no room on the disk."""
    with path.open("wb") as file:
        file.truncate(2**30)


def holes() -> tuple[np.ndarray, np.ndarray]:
    """Of a sphere of 320 faces, every eighth.

    Refused where the body is their convex hull, which a picture does not show. CoACD takes the
    faces as separate bodies; then a picture shows all that can be pushed, and the mesh loads.
    """
    import trimesh

    ball = trimesh.creation.icosphere(2)
    return np.asarray(ball.vertices), np.asarray(ball.faces)[::8]


def jumbled() -> tuple[np.ndarray, np.ndarray]:
    """A box, half of whose faces are wound inwards."""
    vertices, faces = box()
    faces[::2] = faces[::2, ::-1]
    return vertices, faces


def soup() -> tuple[np.ndarray, np.ndarray]:
    """A box whose faces share no vertex."""
    vertices, faces = box()
    return vertices[faces].reshape(-1, 3), np.arange(36).reshape(12, 3)


def crossing() -> tuple[np.ndarray, np.ndarray]:
    """Two boxes that cut through each other."""
    vertices, faces = box(1.0, 0.3, 0.3)
    across = vertices[:, [1, 0, 2]] + 0.1  # mirrored, so its faces have to be turned over
    return np.vstack([vertices, across]), np.vstack([faces, faces[:, ::-1] + 8])


def fin() -> tuple[np.ndarray, np.ndarray]:
    """A box with a triangle on one of its edges: three faces share it."""
    vertices, faces = box()
    return np.vstack([vertices, [[-0.2, -0.2, 0.3]]]), np.vstack([faces, [[0, 1, 8]]])


def apart() -> tuple[np.ndarray, np.ndarray]:
    """Two boxes that do not touch."""
    vertices, faces = box(0.5, 0.5, 0.5)
    return np.vstack([vertices, vertices + 0.7]), np.vstack([faces, faces + 8])


def changed(vertices: np.ndarray, faces: np.ndarray) -> Callable[..., Write]:
    """A writer of a box with these vertices or faces added."""
    first, others = box()
    return obj(np.vstack([first, vertices]), [*others.tolist(), *faces])


NONE = np.zeros((0, 3))
BOX = box()
QUADS = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
CORNERS = "".join(f"v {x} {y} {z}\n" for x, y, z in BOX[0])
BACKWARDS = "".join(
    "f " + " ".join(str(int(k) - 9) for k in line.split()[1:]) + "\n" for line in QUADS.splitlines()
)
LONG = "mesh with a very long name " * 9

# File -> how it is written. All of these load.
GOOD: dict[str, Write] = {
    "box.obj": obj(*BOX),
    "binary.stl": stl(*BOX),
    "LOUD.STL": stl(*BOX),
    "parts.glb": lambda path: glb(BOX, (BOX[0] + 0.5, BOX[1]))(path),
    "quads.obj": text(CORNERS + QUADS),
    "counted_backwards.obj": text(CORNERS + BACKWARDS),
    "windows_lines.obj": obj(*BOX, end="\r\n"),
    "commented.obj": obj(*BOX, before="# made by hand\no body\ns off\n"),
    "no_material.obj": obj(*BOX, before="mtllib missing.mtl\nusemtl gone\n"),
    "inverted.obj": obj(BOX[0], BOX[1][:, ::-1]),
    "jumbled.obj": obj(*jumbled()),
    "soup.obj": obj(*soup()),
    "fin.obj": obj(*fin()),
    "crossing.obj": obj(*crossing()),
    "apart.obj": obj(*apart()),
    "open.obj": obj(BOX[0], BOX[1][[0, 1, 2, 3, 4, 6, 7, 8, 9, 10]]),
    "dome.obj": obj(*dome()),
    "dome_inside_out.obj": obj(dome()[0], dome()[1][:, ::-1]),
    "double_faces.obj": obj(BOX[0], [*BOX[1], *BOX[1][:5]]),
    "double_vertices.obj": changed(BOX[0], [[8, 9, 11]]),
    "degenerate_faces.obj": changed(NONE, [[0, 0, 1], [0, 1, 0], [3, 3, 3]]),
    "sliver.obj": changed(np.array([[0.5, 0.0, 0.0]]), [[0, 4, 8]]),
    "nan_in_no_face.obj": changed(np.full((1, 3), np.nan), []),
    "far_point_in_no_face.obj": changed(np.full((1, 3), 1e6), []),
    "dust.obj": obj(1e-9 * BOX[0], BOX[1]),
    "huge.obj": obj(1e9 * BOX[0], BOX[1]),
    "vast.obj": obj(1e200 * BOX[0], BOX[1]),
    "far_away.obj": obj(BOX[0] + 1e4, BOX[1]),
    "slab.obj": obj(*box(1.0, 1.0, 0.001)),
    "rod.obj": obj(*box(1.0, 0.05, 0.05)),
    "ünï çødé 物体.obj": obj(*BOX),
    "a;b.obj": obj(*BOX),
    f"{LONG[:230]}.obj": obj(*BOX),
    "link.obj": link("box.obj"),
}

PNG = b"\x89PNG\r\n\x1a\n" + bytes(60)
JSON = json.dumps({"asset": {"version": "2.0"}, "meshes": "none"}).encode()

# File -> how it is written, and what the one line about it says. All of these are left out.
BAD: dict[str, tuple[Write, str]] = {
    "needle.obj": (obj(*box(1000.0, 0.6, 0.4)), r"it is a needle, 1\d\d\d times as long as wide"),
    "flat.obj": (obj(*box(1.0, 1.0, 0.0)), "it is flat"),
    "triangle.obj": (obj(BOX[0][:3], [[0, 1, 2]]), "it is flat"),
    "line.obj": (obj(np.outer(np.arange(4), [1, 1, 1]), [[0, 1, 2], [1, 2, 3]]), "have no area"),
    "point.obj": (obj(np.ones((4, 3)), [[0, 1, 2], [1, 2, 3]]), "in one place|have no area"),
    "nan.obj": (obj(np.where(BOX[0] == 1.0, np.nan, BOX[0]), BOX[1]), "not finite"),
    "inf.obj": (obj(np.where(BOX[0] == 1.0, np.inf, BOX[0]), BOX[1]), "not finite"),
    "nan.stl": (stl(np.where(BOX[0] == 1.0, np.nan, BOX[0]), BOX[1]), "not finite"),
    "empty.obj": (text(""), "the file is empty"),
    "empty.stl": (text(""), "the file is empty"),
    "empty.glb": (text(""), "the file is empty"),
    "no_faces.obj": (text(CORNERS), "no faces|cannot be used"),
    "no_faces.stl": (stl(BOX[0], BOX[1][:0]), "no faces|cannot be used"),
    "only_double_corners.obj": (obj(BOX[0], [[0, 0, 1], [2, 2, 3]]), "no area|no faces"),
    "prose.obj": (text("no mesh"), "cannot be used"),
    "words.obj": (text("v a b c\nv d e f\nv g h i\nf 1 2 3\n"), "cannot be used"),
    "no_such_vertex.obj": (obj(BOX[0], [[0, 1, 99]]), "cannot be used"),
    "picture.obj": (data(PNG), "cannot be used"),
    "zeros.glb": (data(bytes(400)), "cannot be used"),
    "zeros.stl": (data(bytes(400)), "cannot be used"),
    "stl_as.obj": (stl(*BOX), "cannot be used"),
    "obj_as.stl": (obj(*BOX), "cannot be used"),
    "obj_as.glb": (obj(*BOX), "cannot be used"),
    "truncated.stl": (stl(*BOX, cut=30), "cannot be used"),
    "truncated.glb": (lambda path: glb(BOX, cut=200)(path), "cannot be used"),
    "truncated.obj": (text(CORNERS[:60]), "cannot be used"),
    "boastful.stl": (stl(*BOX, count=2**32 - 1), "cannot be used"),
    "odd_json.glb": (
        data(struct.pack("<4sIIII", b"glTF", 2, 20 + len(JSON), len(JSON), 0x4E4F534A) + JSON),
        "cannot be used",
    ),
    "far_too_large.stl": (sparse, "1024 MiB"),
    "holes.obj": (lambda path: obj(*holes())(path), "cannot be seen from above"),
    "dangling.obj": (link("gone.obj"), "points to gone.obj, which does not exist; remove the link"),
    "looping.obj": (link("looping.obj"), "leads back to itself; remove it"),
    "dangling_folder": (link("gone"), "points to gone, which does not exist"),
    "looping_folder": (link("."), "leads back to a folder that it is in; remove it"),
    os.fsdecode(b"latin-1 \xe9.obj"): (obj(*BOX), "no valid UTF-8, so rename it"),
    "pipe.obj": (lambda path: os.mkfifo(path), "is no regular file"),
    "unreadable.obj": (unreadable, "Permission denied"),
}
