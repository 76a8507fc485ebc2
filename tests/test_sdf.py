"""Signed distance fields against brute force, and masks without a contour."""

import numpy as np
import pytest
from configs import real_config
from scipy.ndimage import binary_closing

from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.sdf import SDF_METHODS, signed_distance, signed_distances

# Largest difference from brute force in pixels, on the masks below and near the contour.
# Fast marching cuts corners: a corner's pixel has its contour at 0.5 / sqrt(2) instead of 0.5.
TOLERANCE = {"fmm": 0.5, "edt": 1e-5}
APART = 0.5  # pixels, the most that two methods differ by anywhere
ROWS, COLUMNS = np.mgrid[:40, :48]


def blob(seed: int) -> np.ndarray:
    noise = np.random.default_rng(seed).random(ROWS.shape) < 0.12
    return binary_closing(noise, iterations=2)


def line(from_row: int, slope: float) -> np.ndarray:
    return np.abs(ROWS - from_row - slope * COLUMNS) < 0.5


MASKS = {
    "disc": np.hypot(ROWS - 18.3, COLUMNS - 20.6) < 9,
    "small disc": np.hypot(ROWS - 5, COLUMNS - 40) < 1.8,
    "rectangle": (abs(ROWS - 20) < 6) & (abs(COLUMNS - 30) < 11),
    "at the edge": (ROWS < 7) & (COLUMNS > 30),
    "ring": abs(np.hypot(ROWS - 20, COLUMNS - 24) - 12) < 3,
    "two parts": (np.hypot(ROWS - 9, COLUMNS - 9) < 5) | (np.hypot(ROWS - 28, COLUMNS - 36) < 6),
    "level line": ROWS == 12,
    "slanting line": line(4, 0.6),
    "pixel": (ROWS == 20) & (COLUMNS == 20),
    "all but a pixel": (ROWS != 20) | (COLUMNS != 20),
    **{f"blob {seed}": blob(seed) for seed in range(4)},
}


def brute_force(mask: np.ndarray) -> np.ndarray:
    """Distance to the nearest pixel of the other side, less the half pixel up to the contour."""
    sides = [np.argwhere(mask), np.argwhere(~mask)]
    field = np.empty(mask.shape)
    for sign, own, other in ((-1, *sides), (1, *sides[::-1])):
        gaps = np.linalg.norm(own[:, None] - other[None], axis=-1).min(axis=1)
        field[tuple(own.T)] = sign * (gaps - 0.5)
    return field


@pytest.mark.parametrize("name", MASKS)
@pytest.mark.parametrize("method", SDF_METHODS)
def test_agrees_with_brute_force(method: str, name: str) -> None:
    field, expected = signed_distance(MASKS[name], method), brute_force(MASKS[name])
    assert (field.dtype, field.shape) == (np.float32, MASKS[name].shape)
    np.testing.assert_array_equal(field < 0, MASKS[name])
    np.testing.assert_allclose(field, expected, atol=TOLERANCE[method])


@pytest.mark.parametrize("name", MASKS)
def test_methods_differ_by_less_than_half_a_pixel(name: str) -> None:
    fields = np.stack([signed_distance(MASKS[name], method) for method in SDF_METHODS])
    assert np.ptp(fields, axis=0).max() < APART


@pytest.mark.parametrize("method", SDF_METHODS)
def test_worked_by_hand(method: str) -> None:
    """Columns 2 and 3 of 6 are inside: the contour runs at 1.5 and 3.5."""
    mask = np.zeros((4, 6), dtype=bool)
    mask[:, 2:4] = True
    expected = np.tile([1.5, 0.5, -0.5, -0.5, 0.5, 1.5], (4, 1))
    np.testing.assert_allclose(signed_distance(mask, method), expected, atol=1e-6)


@pytest.mark.parametrize("radius", [3, 8, 15])
@pytest.mark.parametrize("method", SDF_METHODS)
def test_a_drawn_disc_has_the_distances_of_a_disc(method: str, radius: int) -> None:
    true = np.hypot(ROWS - 19.7, COLUMNS - 23.4) - radius
    error = np.abs(signed_distance(true < 0, method) - true)
    assert error.max() < 0.75
    assert error.mean() < 0.3


@pytest.mark.parametrize("method", SDF_METHODS)
def test_masks_without_a_contour(method: str) -> None:
    empty = np.zeros((30, 40), dtype=bool)
    np.testing.assert_array_equal(signed_distance(empty, method), np.full((30, 40), 50.0))
    np.testing.assert_array_equal(signed_distance(~empty, method), np.full((30, 40), -50.0))
    fields = signed_distances(np.stack([empty, ~empty]), method)
    assert fields[:, 0, 0].tolist() == [50.0, -50.0]
    assert signed_distances(np.zeros((0, 30, 40), dtype=bool), method).shape == (0, 30, 40)


def test_kept_per_mask_and_method() -> None:
    mask = MASKS["disc"]
    fields = [signed_distance(mask, method) for method in SDF_METHODS]
    again = [signed_distance(mask.copy(), method) for method in SDF_METHODS]
    assert all(a is b for a, b in zip(fields, again, strict=True))
    assert not np.array_equal(*fields)
    # The same bits in another shape are another mask.
    assert signed_distance(mask.reshape(48, 40)).shape == (48, 40)
    with pytest.raises(ValueError, match="read-only"):
        fields[0][0, 0] = 0


def test_the_config_names_a_method_and_another_is_refused() -> None:
    assert real_config("perception=oracle").env.perception.sdf in SDF_METHODS
    with pytest.raises(
        SdfgcnError, match=r"env\.perception\.sdf is 'exact', but must be one of edt"
    ):
        signed_distance(MASKS["ring"], "exact")
