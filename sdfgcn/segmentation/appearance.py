"""Random looks of an arrangement: light, camera, colours and patterns (domain randomisation).

Whatever MuJoCo can change between two pictures is changed in the model; patterns are painted into
the picture using the true masks.
"""

from __future__ import annotations

import colorsys
from collections.abc import Sequence

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation

from sdfgcn.config import ArenaConfig, ArrangementsConfig
from sdfgcn.sim.arena import CAMERA


class Appearance:
    """Changes the look of a compiled world, and restores the environment's own."""

    def __init__(
        self, physics: mjcf.Physics, arena: ArenaConfig, arrangements: ArrangementsConfig
    ) -> None:
        """Remember the environment's own look."""
        self._model, self._data = physics.model.ptr, physics.data.ptr
        self._arena, self._arrangements = arena, arrangements
        self._camera = self._model.camera(CAMERA).id
        self._lamp = self._model.light("lamp").id
        self._table = self._model.geom("table").id
        self._own = [(array, array.copy()) for array in self._arrays()]

    def reset(self) -> None:
        """Restore the environment's own light, camera and table; props are coloured separately."""
        for array, value in self._own:
            array[:] = value
        mujoco.mj_camlight(self._model, self._data)

    def colour_from(
        self,
        rng: np.random.Generator,
        geoms: NDArray[np.int64],
        palette: Sequence[Sequence[float]],
    ) -> None:
        """Colour the [n] props as an episode does: from a palette, but textured ones unchanged."""
        order = rng.permutation(len(palette))[np.arange(len(geoms)) % len(palette)]
        for geom, colour in zip(geoms, np.asarray(palette)[order], strict=True):
            textured = self._model.geom_matid[geom] >= 0
            self._model.geom_rgba[geom, :3] = 1.0 if textured else colour

    def draw(self, rng: np.random.Generator, geoms: NDArray[np.int64]) -> None:
        """Randomise light, camera and the colours of the table and the [n] visual prop geoms."""
        self.reset()
        model, arrangements = self._model, self._arrangements
        place = [
            _within(rng, axis)
            for axis in (arrangements.lamp_x, arrangements.lamp_y, arrangements.lamp_z)
        ]
        aim = np.array([*rng.uniform(-0.2, 0.2, 2), 0.0]) - place
        model.light_pos[self._lamp] = place
        model.light_dir[self._lamp] = aim / np.linalg.norm(aim)
        model.light_diffuse[self._lamp] = _within(rng, arrangements.lamp_diffuse) * _tint(rng)
        model.vis.headlight.ambient[:] = _within(rng, arrangements.ambient) * _tint(rng)
        model.vis.headlight.diffuse[:] = _within(rng, arrangements.headlight_diffuse) * _tint(rng)
        self._draw_camera(rng)
        table = random_colour(rng)
        if rng.random() < 0.3:
            table = np.clip(self._arena.table_rgba[:3] + rng.normal(0.0, 0.1, 3), 0.0, 1.0)
        model.geom_rgba[self._table, :3] = table
        shared = random_colour(rng) if rng.random() < 0.15 else None  # only shape tells them apart
        for geom in geoms:
            self._colour_prop(rng, geom, table, shared)
        mujoco.mj_camlight(model, self._data)

    def _draw_camera(self, rng: np.random.Generator) -> None:
        model, arrangements = self._model, self._arrangements
        turn = Rotation.from_euler(
            "xyz", rng.normal(0.0, arrangements.camera_turn, 3), degrees=True
        )
        quat = Rotation.from_quat(model.cam_quat[self._camera], scalar_first=True) * turn
        model.cam_quat[self._camera] = quat.as_quat(scalar_first=True)
        model.cam_pos[self._camera] += rng.normal(0.0, arrangements.camera_shift, 3)
        model.cam_fovy[self._camera] = _within(rng, arrangements.fovy)

    def _colour_prop(
        self,
        rng: np.random.Generator,
        geom: int,
        table: NDArray[np.float64],
        shared: NDArray[np.float64] | None,
    ) -> None:
        """Colour a prop; a texture is kept, faintly tinted or dropped."""
        model = self._model
        if model.geom_matid[geom] >= 0:
            kind = rng.random()
            if kind < 0.6:
                model.geom_rgba[geom, :3] = (
                    rng.uniform(0.6, 1.0) * _tint(rng) if kind < 0.3 else 1.0
                )
                return
            model.geom_matid[geom] = -1
        if shared is not None:
            colour = np.clip(shared + rng.normal(0.0, 0.05, 3), 0.0, 1.0)
        elif rng.random() < 0.08:  # hard to tell from the table
            colour = np.clip(table + rng.choice([-1, 1]) * rng.uniform(0.08, 0.25, 3), 0.0, 1.0)
        else:
            colour = random_colour(rng)
        model.geom_rgba[geom, :3] = colour

    def _arrays(self) -> list[NDArray]:
        model = self._model
        return [
            model.light_pos,
            model.light_dir,
            model.light_diffuse,
            model.vis.headlight.ambient,
            model.vis.headlight.diffuse,
            model.cam_pos,
            model.cam_quat,
            model.cam_fovy,
            model.geom_rgba,
            model.geom_matid,
        ]


def random_colour(rng: np.random.Generator) -> NDArray[np.float64]:
    """[3] a colour, 0 to 1, of uniform hue and saturation."""
    hue, saturation, value = rng.random(), rng.random(), rng.uniform(0.08, 1.0)
    return np.array(colorsys.hsv_to_rgb(hue, saturation, value))


def _within(rng: np.random.Generator, limits: Sequence[float]) -> float:
    low, high = limits
    return rng.uniform(low, high)


def _tint(rng: np.random.Generator) -> NDArray[np.float64]:
    """[3] a near-white light colour."""
    return np.clip(rng.normal(1.0, 0.08, 3), 0.7, 1.3)


def paint(
    rng: np.random.Generator,
    pixels: NDArray[np.uint8],
    labels: NDArray[np.uint8],
    chance: float,
) -> NDArray[np.uint8]:
    """Paint patterns on random objects and perhaps the table, keeping the shading.

    Args:
        rng: Source of randomness.
        pixels: [H, W, 3] picture.
        labels: [H, W] 0 for the table, 1 to n for objects.
        chance: Probability of a pattern, for each label.
    """
    painted = pixels.astype(np.float32)
    for label in np.unique(labels):
        if rng.random() >= chance:
            continue
        where = labels == label
        strength = rng.uniform(0.1, 0.35 if label == 0 else 0.9)
        pattern = PATTERNS[rng.integers(len(PATTERNS))](rng, labels.shape[0])
        low, high = random_colour(rng), random_colour(rng)
        # Blend towards colours scaled by the brightness underneath.
        mixed = (low + pattern[..., None] * (high - low))[where]
        light = painted[where].mean(axis=-1, keepdims=True) / 128.0
        painted[where] += strength * (255.0 * mixed * np.maximum(light, 0.2) - painted[where])
    return np.clip(painted, 0.0, 255.0).astype(np.uint8)


def _noise(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    """[size, size] smooth noise, 0 to 1."""
    cells = int(rng.integers(4, 40))
    coarse = Image.fromarray(rng.random((cells, cells), dtype=np.float32))
    return np.clip(np.asarray(coarse.resize((size, size), Image.Resampling.BICUBIC)), 0.0, 1.0)


def _stripes(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    """[size, size] stripes in a random direction, sharp or soft, 0 to 1."""
    angle, period = rng.uniform(0.0, np.pi), rng.uniform(2.5, 12.0)
    v, u = np.mgrid[:size, :size]
    wave = np.sin(2 * np.pi / period * (u * np.cos(angle) + v * np.sin(angle)) + rng.uniform(0, 6))
    return (0.5 + 0.5 * np.clip(rng.choice([1.0, 5.0]) * wave, -1.0, 1.0)).astype(np.float32)


def _checker(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    """[size, size] a rotated chequerboard, 0 and 1."""
    angle, side = rng.uniform(0.0, np.pi), rng.uniform(2.0, 10.0)
    v, u = np.mgrid[:size, :size]
    across = np.floor((u * np.cos(angle) + v * np.sin(angle)) / side)
    along = np.floor((v * np.cos(angle) - u * np.sin(angle)) / side)
    return ((across + along) % 2).astype(np.float32)


def _speckle(rng: np.random.Generator, size: int) -> NDArray[np.float32]:
    """[size, size] independent noise per pixel, 0 to 1."""
    return rng.random((size, size), dtype=np.float32)


PATTERNS = (_noise, _stripes, _checker, _speckle)
