"""Scanned objects from the myosuite wheel: textured YCB meshes and untextured object_sim ones."""

from __future__ import annotations

import io
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import distance_transform_edt

from sdfgcn.config import ObjectsConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.convex import slice_into_hulls
from sdfgcn.objects.fetch import fetch, scans_dir
from sdfgcn.objects.meshes import decimate, weld
from sdfgcn.objects.model import Recipe, Shape, Source
from sdfgcn.registry import OBJECTS

# Category -> names, per split; the splits share no category.
TRAIN: dict[str, tuple[str, ...]] = {
    "box": ("003_cracker_box", "004_sugar_box", "008_pudding_box", "009_gelatin_box"),
    "squeeze_bottle": ("006_mustard_bottle",),
    "fruit": ("apple", "banana"),
    "kitchenware": ("fryingpan", "knife"),
    "tool": ("035_power_drill", "hammer", "scissors", "flashlight"),
    "office": ("stapler", "stamp"),
    "electronics": ("camera", "phone", "mouse", "gamecontroller", "headphones"),
    "homeware": ("alarmclock", "lightbulb"),
    "wearable": ("watch", "eyeglasses"),
    "bathroom": ("toothbrush", "toothpaste"),
    "optics": ("binoculars",),
    "instrument": ("flute",),
    "body_part": ("hand",),
    "block": ("cubemedium", "cylindermedium", "pyramidmedium"),
}
TEST: dict[str, tuple[str, ...]] = {
    "can": ("002_master_chef_can", "005_tomato_soup_can", "007_tuna_fish_can",
            "010_potted_meat_can"),
    "drinkware": ("bowl", "cup", "coffeemug", "teapot", "waterbottle", "wineglass"),
    "toy": ("airplane", "train", "duck", "elephant", "stanfordbunny", "piggybank"),
}  # fmt: skip

# Concave meshes supplied with at most one hull -> number of convex pieces to cut them into.
SLICES = {"035_power_drill": 10, "train": 8, "alarmclock": 8}
SLICED_FACES = 4000  # fine enough to follow the outline within 2 mm


def recipes(cfg: ObjectsConfig) -> list[Recipe]:
    """Fetch the scans if needed and return the recipes of all 32 train and 16 test objects.

    Raises:
        SdfgcnError: The scans are neither cached nor downloadable.
    """
    folder = fetch()
    return [
        Recipe(name, category, split, partial(read_scan, folder, name, cfg))
        for split, table in (("train", TRAIN), ("test", TEST))
        for category, names in table.items()
        for name in names
    ]


OBJECTS.register("scanned")(Source(recipes))


def read_scan(folder: Path, name: str, cfg: ObjectsConfig) -> Shape:
    """Read one object; names that start with a digit are from YCB.

    Raises:
        SdfgcnError: A file is missing or truncated.
    """
    try:
        if name[0].isdigit():
            return _read_ycb(folder / "YCB_sim", name, cfg)
        return _read_object_sim(folder / "object_sim" / name)
    except (OSError, ValueError) as error:
        raise SdfgcnError(
            f"The scan {name} in {scans_dir()} is damaged ({error}); delete that folder and run "
            "`python -m sdfgcn.objects.fetch` to fetch it again."
        ) from error


def _read_object_sim(folder: Path) -> Shape:
    vertices, faces = weld(read_stl(folder / f"{folder.name}.stl"))
    if folder.name in SLICES:
        pieces = _sliced(vertices, faces, SLICES[folder.name])
    else:
        files = sorted(path for path in folder.iterdir() if path.name.startswith("contact"))
        pieces = tuple(read_stl(path).reshape(-1, 3) for path in files)
    return Shape(vertices, faces, pieces)


def _read_ycb(folder: Path, name: str, cfg: ObjectsConfig) -> Shape:
    vertices, uv, faces = read_msh(folder / "meshes" / f"{name}.msh")
    # Boxes, cans and bottles are almost convex.
    pieces = _sliced(vertices, faces, SLICES[name]) if name in SLICES else (vertices,)
    texture = shrink_texture((folder / "textures" / f"{name}.png").read_bytes(), cfg.texture_size)
    return Shape(vertices, faces, pieces, uv, texture)


def _sliced(vertices: NDArray, faces: NDArray, count: int) -> tuple[NDArray, ...]:
    coarse, coarse_faces, _ = decimate(vertices, faces, None, SLICED_FACES)
    return tuple(slice_into_hulls(coarse, coarse_faces, count))


def read_stl(path: Path) -> NDArray[np.float64]:
    """Read a binary STL file as triangles [F, 3, 3].

    Raises:
        ValueError: The file length does not match the header.
    """
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little")
    if len(content) != 84 + 50 * count:
        raise ValueError(f"{path.name} holds {len(content)} bytes instead of {84 + 50 * count}")
    layout = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(content, layout, count, offset=84)["corners"].astype(float)


def read_msh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]:
    """Read MuJoCo's binary mesh format: vertices [V, 3], uv [V, 2] and faces [F, 3].

    Raises:
        ValueError: The file length does not match the header, or there is no uv.
    """
    content = path.read_bytes()
    counts = np.frombuffer(content, "<i4", 4) if len(content) >= 16 else np.zeros(4, int)
    n_vertices, n_normals, n_uv, n_faces = (int(count) for count in counts)
    expected = 16 + 12 * n_vertices + 12 * n_normals + 8 * n_uv + 12 * n_faces
    if len(content) != expected or n_uv != n_vertices:
        raise ValueError(f"{path.name} holds {len(content)} bytes instead of {expected}")
    numbers = np.frombuffer(content, "<f4", offset=16)
    vertices = numbers[: 3 * n_vertices].reshape(-1, 3)
    start = 3 * (n_vertices + n_normals)
    uv = numbers[start : start + 2 * n_uv].reshape(-1, 2)
    faces = numbers[start + 2 * n_uv :].view("<i4").reshape(-1, 3)
    return vertices.astype(float), uv.astype(float), faces.astype(np.int32)


def shrink_texture(png: bytes, size: int) -> NDArray[np.uint8]:
    """Return a PNG texture atlas as square RGB, uint8 [size, size, 3].

    The black between the atlas's islands is filled with the nearest colour; otherwise it would
    bleed into the shrunken islands and leave dark seams on the object.
    """
    with Image.open(io.BytesIO(png)) as image:
        full = image.convert("RGB")
    used = Image.fromarray(np.asarray(full).any(axis=2).astype(np.uint8) * 255)
    small = np.asarray(full.resize((size, size), Image.Resampling.BOX), float)
    share = np.asarray(used.resize((size, size), Image.Resampling.BOX), float) / 255.0
    colours = small / np.maximum(share, 0.02)[:, :, None]
    nearest = distance_transform_edt(share < 0.1, return_distances=False, return_indices=True)
    return colours[tuple(nearest)].clip(0, 255).astype(np.uint8)
