"""Signed distance fields against brute force, masks without a contour, and what is remembered."""

import numpy as np
import pytest
import torch
from configs import real_config
from scipy.ndimage import binary_closing, distance_transform_edt

from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.sdf import SDF_METHODS, SdfTransform

# Largest difference from brute force in pixels, on the masks below and near the contour.
# Fast marching cuts corners: a corner's pixel has its contour at 0.5 / sqrt(2) instead of 0.5.
TOLERANCE = {"fmm": 0.5, "edt": 1e-5}
APART = 0.5  # pixels, the most that two methods differ by anywhere
SIZE = 48
ROWS, COLUMNS = np.mgrid[:SIZE, :SIZE]


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


def distances(mask: np.ndarray, method: str = "fmm") -> np.ndarray:
    """The field of one square mask."""
    (field,) = SdfTransform(method, len(mask)).fields(mask[None])
    return field


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
    field, expected = distances(MASKS[name], method), brute_force(MASKS[name])
    assert (field.dtype, field.shape) == (np.float32, MASKS[name].shape)
    np.testing.assert_array_equal(field < 0, MASKS[name])
    np.testing.assert_allclose(field, expected, atol=TOLERANCE[method])


@pytest.mark.parametrize("name", MASKS)
def test_methods_differ_by_less_than_half_a_pixel(name: str) -> None:
    fields = np.stack([distances(MASKS[name], method) for method in SDF_METHODS])
    assert np.ptp(fields, axis=0).max() < APART


@pytest.mark.parametrize("method", SDF_METHODS)
def test_worked_by_hand(method: str) -> None:
    """Columns 2 and 3 of 6 are inside: the contour runs at 1.5 and 3.5."""
    mask = np.zeros((6, 6), dtype=bool)
    mask[:, 2:4] = True
    expected = np.tile([1.5, 0.5, -0.5, -0.5, 0.5, 1.5], (6, 1))
    np.testing.assert_allclose(distances(mask, method), expected, atol=1e-6)


@pytest.mark.parametrize("radius", [3, 8, 15])
@pytest.mark.parametrize("method", SDF_METHODS)
def test_a_drawn_disc_has_the_distances_of_a_disc(method: str, radius: int) -> None:
    true = np.hypot(ROWS - 19.7, COLUMNS - 23.4) - radius
    error = np.abs(distances(true < 0, method) - true)
    assert error.max() < 0.75
    assert error.mean() < 0.3


def test_a_rectangle_in_a_picture_by_hand() -> None:
    # Its edges run at 30 and 50 down, 20 and 70 across, pixel centres at k + 0.5.
    rows, columns = np.indices((96, 96)) + 0.5
    mask = np.zeros((96, 96), dtype=bool)
    mask[30:50, 20:70] = True
    field = distances(mask)
    down, across = np.abs(rows - 40) - 10, np.abs(columns - 45) - 25
    inside = np.maximum(down, across)
    exact = np.where(inside < 0, inside, np.hypot(np.maximum(down, 0), np.maximum(across, 0)))
    assert np.abs(field - exact).max() < 1.0
    # The pixel beside an edge is half a pixel from it, the middle row 9.5 pixels in.
    assert field[40, 19] == pytest.approx(0.5, abs=0.05)
    assert field[40, 20] == pytest.approx(-0.5, abs=0.05)
    assert field[40, 45] == pytest.approx(-9.5, abs=0.2)
    assert field[5, 45] == pytest.approx(24.5, abs=0.2)


def test_two_parts_and_a_hole_in_a_picture() -> None:
    rows, columns = np.indices((96, 96)) + 0.5
    radius = np.hypot(rows - 48, columns - 48)
    mask = (radius <= 22) & (radius > 9)
    mask[2:12, 60:90] = True
    field = distances(mask)
    # The contour runs half a pixel before the nearest pixel of the other kind.
    exact = np.where(mask, 0.5 - distance_transform_edt(mask), distance_transform_edt(~mask) - 0.5)
    assert np.abs(field - exact).max() < 1.0
    assert ((field < 0) == mask).all()
    assert field[48, 48] > 7.0  # in the hole
    disc = radius <= 20
    assert np.abs(distances(disc) - (radius - 20)).max() < 1.0


@pytest.mark.parametrize("method", SDF_METHODS)
def test_masks_without_a_contour(method: str) -> None:
    diagonal = SIZE * np.sqrt(2)
    empty = np.zeros((SIZE, SIZE), dtype=bool)
    fields = SdfTransform(method, SIZE).fields(np.stack([empty, ~empty]))
    np.testing.assert_allclose(fields[0], diagonal, rtol=1e-6)
    np.testing.assert_allclose(fields[1], -diagonal, rtol=1e-6)
    assert SdfTransform(method, SIZE).fields(empty[None][:0]).shape == (0, SIZE, SIZE)


def test_the_config_names_a_method_and_another_is_refused() -> None:
    assert real_config("perception=oracle").env.perception.sdf in SDF_METHODS
    with pytest.raises(
        SdfgcnError, match=r"env\.perception\.sdf is 'exact', but must be one of edt"
    ):
        SdfTransform("exact", SIZE)


# ------------------------------------------------------------------ what is remembered


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """The masks whose fields were computed and not remembered."""
    masks: list[np.ndarray] = []
    method = SDF_METHODS["edt"]
    monkeypatch.setitem(SDF_METHODS, "edt", lambda mask: masks.append(mask) or method(mask))
    return masks


def test_a_field_is_computed_once(computed: list[np.ndarray]) -> None:
    transform = SdfTransform("edt", SIZE)
    masks = np.stack([MASKS["disc"], MASKS["ring"]])
    first = transform.fields(masks)
    again = transform.fields(masks[::-1].copy())
    np.testing.assert_array_equal(first, again[::-1])
    assert (len(computed), len(transform)) == (2, 2)
    # A caller may change what it got.
    first[:] = 0.0
    np.testing.assert_array_equal(transform.fields(masks), again[::-1])
    SdfTransform("edt", SIZE).fields(masks)  # another one remembers nothing of it
    assert len(computed) == 4


def test_the_fields_used_last_are_kept(computed: list[np.ndarray]) -> None:
    transform = SdfTransform("edt", SIZE, kept=2)
    for name in ("disc", "ring", "disc", "pixel", "disc"):
        transform.fields(MASKS[name][None])
    # The ring went when the pixel came: the disc had been used since.
    assert (len(computed), len(transform)) == (3, 2)
    transform.fields(MASKS["ring"][None])
    assert len(computed) == 4


def test_half_precision_is_near_enough() -> None:
    fields = distances(MASKS["disc"], "edt")
    (half,) = SdfTransform("edt", SIZE, precision=np.float16).fields(MASKS["disc"][None])
    assert half.dtype == np.float32
    assert 0 < np.abs(half - fields).max() < 0.13
    near = np.abs(fields) < 1.0
    assert np.abs(half - fields)[near].max() < 0.001


# ------------------------------------------------------------------ bits of masks


def test_packed_and_unpacked(computed: list[np.ndarray]) -> None:
    transform = SdfTransform("edt", SIZE)
    names = ["disc", "ring", "pixel"]
    sdf = torch.zeros(2, 3, SIZE, SIZE)
    node_mask = torch.tensor([[True, True, False], [False, False, True]])
    fields = transform.fields(np.stack([MASKS[name] for name in names]))
    sdf[node_mask] = torch.from_numpy(fields)
    bits = transform.pack(sdf, node_mask)
    assert (bits.shape, bits.dtype) == ((2, 3, SIZE * SIZE // 8), torch.uint8)
    assert bits[0, 0].tolist() == np.packbits(MASKS["disc"]).tolist()
    assert not bits[~node_mask].any()
    assert torch.equal(transform.unpack(bits, node_mask), sdf)
    # What was packed is remembered, and what no row holds is not.
    assert (len(computed), len(transform)) == (3, 3)
    other = SdfTransform("edt", SIZE)
    other.pack(sdf, node_mask)
    assert len(other) == 3
    assert torch.equal(SdfTransform("edt", SIZE).unpack(bits, node_mask), sdf)
    assert len(computed) == 6
