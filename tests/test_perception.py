"""Distance fields, masks and push starts against pictures drawn by hand."""

from dataclasses import replace

import numpy as np
import pytest
from configs import real_config
from scipy.ndimage import distance_transform_edt
from sdfgcn.perception.perception import detected
from sdfgcn.perception.push_start import PushPlan, PushPlanner, centers

from sdfgcn.config import N_DIRECTIONS, ArenaConfig, PushConfig
from sdfgcn.perception.oracle import oracle_masks
from sdfgcn.perception.sdf import signed_distance, signed_distances
from sdfgcn.sim.push import direction_vector
from sdfgcn.task.camera import CameraModel

SIZE = 96
PIXEL = 0.005  # metres on the table, under the camera of these tests
ROWS, COLUMNS = np.indices((SIZE, SIZE))


def rectangle(rows: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
    """The mask of pixels with row and column in the half-open ranges."""
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[slice(*rows), slice(*columns)] = True
    return mask


def disc(radius: float, row: float = 48.0, column: float = 48.0) -> np.ndarray:
    """Pixels whose centre lies within `radius` pixels of (row, column), the picture's middle."""
    return np.hypot(ROWS + 0.5 - row, COLUMNS + 0.5 - column) <= radius


# ------------------------------------------------------------------ signed distance fields


def test_sdf_of_a_rectangle():
    # Its edges run at 30 and 50 down, 20 and 70 across, pixel centres at k + 0.5.
    field = signed_distance(rectangle((30, 50), (20, 70)))
    down = np.abs(ROWS + 0.5 - 40) - 10
    across = np.abs(COLUMNS + 0.5 - 45) - 25
    inside = np.maximum(down, across)
    exact = np.where(inside < 0, inside, np.hypot(np.maximum(down, 0), np.maximum(across, 0)))
    assert np.abs(field - exact).max() < 1.0
    # By hand: the pixel beside an edge is half a pixel from it, the middle row 9.5 pixels in.
    assert field[40, 19] == pytest.approx(0.5, abs=0.05)
    assert field[40, 20] == pytest.approx(-0.5, abs=0.05)
    assert field[40, 45] == pytest.approx(-9.5, abs=0.2)
    assert field[5, 45] == pytest.approx(24.5, abs=0.2)


def test_sdf_of_a_disc():
    field = signed_distance(disc(20.0))
    exact = np.hypot(ROWS + 0.5 - 48, COLUMNS + 0.5 - 48) - 20
    assert np.abs(field - exact).max() < 1.0


def test_sdf_of_two_parts_and_a_hole_against_brute_force():
    mask = disc(22.0) & ~disc(9.0) | rectangle((2, 12), (60, 90))
    field = signed_distance(mask)
    # The contour runs half a pixel before the nearest pixel of the other kind.
    exact = np.where(mask, 0.5 - distance_transform_edt(mask), distance_transform_edt(~mask) - 0.5)
    assert np.abs(field - exact).max() < 1.0
    assert ((field < 0) == mask).all()
    assert field[48, 48] > 7.0  # in the hole


def test_sdf_without_a_contour_is_the_diagonal():
    diagonal = SIZE * np.sqrt(2)
    empty, full = np.zeros((SIZE, SIZE), bool), np.ones((SIZE, SIZE), bool)
    np.testing.assert_allclose(signed_distance(empty), diagonal, rtol=1e-6)
    np.testing.assert_allclose(signed_distance(full), -diagonal, rtol=1e-6)


def test_sdf_is_kept_and_read_only():
    first, again = signed_distance(disc(7.0)), signed_distance(disc(7.0).copy())
    assert first is again
    assert first.dtype == np.float32
    assert signed_distance(disc(7.0).astype(np.uint8)) is first
    with pytest.raises(ValueError, match="read-only"):
        first[0, 0] = 0.0
    # The same bits in another shape are another picture.
    wide, tall = np.zeros((2, 8), bool), np.zeros((8, 2), bool)
    wide.flat[3] = tall.flat[3] = True
    assert signed_distance(wide).shape == (2, 8)
    assert signed_distance(tall).shape == (8, 2)


def test_sdfs_of_several_masks_are_their_own():
    masks = np.stack([disc(5.0), disc(9.0, 20, 20)])
    fields = signed_distances(masks)
    assert fields.flags.writeable
    for field, mask in zip(fields, masks, strict=True):
        np.testing.assert_array_equal(field, signed_distance(mask))
    assert signed_distances(masks[:0]).shape == (0, SIZE, SIZE)


# ------------------------------------------------------------------ segmentation


def test_masks_follow_the_geom_to_slot_table():
    # Geoms 0 and 4 belong to no slot, 2 to slot 0 and 3 to slot 1; -1 is "nothing there".
    slot_of_geom = np.array([-1, -1, 0, 1, -1, -1])
    geom_ids = np.array([[2, 2, 3], [0, -1, 4], [3, 2, -1]])
    masks = oracle_masks(geom_ids, slot_of_geom, 3)
    assert masks.shape == (3, 3, 3)
    assert masks[0].tolist() == [[True, True, False], [False] * 3, [False, True, False]]
    assert masks[1].tolist() == [[False, False, True], [False] * 3, [True, False, False]]
    assert not masks[2].any()
    assert detected(masks, 3).tolist() == [True, False, False]
    assert detected(masks, 2).tolist() == [True, True, False]


# ------------------------------------------------------------------ where a push starts


@pytest.fixture(scope="module")
def push() -> PushConfig:
    """The real figures, but the picture read as a map of the table itself."""
    return replace(real_config("objects=household").env.push, plane_height=0.0)


@pytest.fixture(scope="module")
def arena() -> ArenaConfig:
    return real_config("objects=household").env.arena


def camera() -> CameraModel:
    """1 m straight above the origin; the picture shows 48 cm, so a pixel is 5 mm."""
    return CameraModel(np.array([0.0, 0.0, 1.0]), np.eye(3), fovy=2 * np.arctan(0.24), size=SIZE)


def plan(masks: list[np.ndarray], push: PushConfig, arena: ArenaConfig) -> PushPlan:
    stack = np.stack(masks)
    return PushPlanner(camera(), push, arena).plan(stack, signed_distances(stack))


MIDDLE = rectangle((40, 56), (40, 56))  # 8 cm square around the origin


@pytest.mark.parametrize(
    ("mask", "center"),
    [
        (MIDDLE, (0.0, 0.0)),
        (rectangle((0, 2), (94, 96)), (0.235, 0.235)),  # top right: far and to the right
        (rectangle((47, 49), (10, 30)), (-0.14, 0.0)),
    ],
)
def test_centre_of_a_mask(mask, center):
    np.testing.assert_allclose(centers(mask[None], camera(), 0.0), [center], atol=1e-9)


def test_directions_are_45_degrees_apart():
    r = np.sqrt(0.5)
    wanted = [[1, 0], [r, r], [0, 1], [-r, r], [-1, 0], [-r, -r], [0, -1], [r, -r]]
    np.testing.assert_allclose(
        [direction_vector(k) for k in range(N_DIRECTIONS)], wanted, atol=1e-12
    )


def test_start_lies_behind_by_half_a_side_and_the_clearance(push, arena):
    offered = plan([MIDDLE], push, arena)
    assert offered.legal.all()
    for k in range(N_DIRECTIONS):
        # From the middle to the edge: half a side, or half a diagonal.
        edge = 0.04 if k % 2 == 0 else 0.04 * np.sqrt(2)
        start = offered.start[0, k]
        # The search walks in steps, and a corner is worn off by a pixel.
        behind = -start @ direction_vector(k)
        assert -PIXEL < behind - (edge + push.clearance) < push.walk
        assert abs(start @ direction_vector((k + 2) % 8)) < 1e-9
        # The surface is a step of the search away from where the tool will meet it.
        assert -PIXEL < offered.free[0, k] - (behind - edge) < PIXEL + push.walk
        command = offered.command(0, k)
        np.testing.assert_array_equal(command.start, start)
        assert (command.direction, command.free) == (k, offered.free[0, k])


def test_tool_fits_between_neighbours_only_if_there_is_room(push, arena):
    # A neighbour to the left, 8 cm wide, from -18 cm or from -16 cm on.
    far, near = rectangle((40, 56), (12, 28)), rectangle((40, 56), (16, 33))
    # 6 cm between the two are enough for 1.9 cm on either side; 3.5 cm are not.
    roomy, tight = plan([MIDDLE, far], push, arena), plan([MIDDLE, near], push, arena)
    alone = plan([MIDDLE], push, arena)
    np.testing.assert_array_equal(roomy.start[0, 0], alone.start[0, 0])
    # Behind the neighbour then, whose far edge is at -16 cm, and its surface comes first.
    behind = -tight.start[0, 0, 0]
    assert -PIXEL < behind - (0.16 + push.clearance) < push.walk
    assert tight.free[0, 0] == pytest.approx(behind - 0.16, abs=PIXEL + push.walk)
    # The other way nothing has changed.
    np.testing.assert_array_equal(tight.start[0, 4], alone.start[0, 4])
    assert tight.free[0, 4] == alone.free[0, 4]
    # The neighbour itself: pushed to the left it needs room on its right, where the square is.
    assert tight.start[1, 4, 0] > 0.04 + push.clearance - PIXEL


def test_no_push_from_beyond_the_tools_bounds(push, arena):
    # The tool may go 5 cm to the left of the middle; behind the square it would need 5.9 cm.
    bounded = replace(arena, reach_x=[-0.05, 0.35])
    offered = plan([MIDDLE], push, bounded)
    assert offered.legal[0].tolist() == [False, False, True, True, True, True, True, False]
    assert np.isnan(offered.start[0, [0, 1, 7]]).all()
    assert np.isfinite(offered.start[0, 2:7]).all()


def test_no_push_from_beyond_the_picture(push, arena):
    # 1 cm from the picture's left edge: no clearance there, and what lies beyond is unknown.
    offered = plan([rectangle((40, 56), (2, 18))], push, arena)
    assert not offered.legal[0, [0, 1, 7]].any()
    assert offered.legal[0, 2:7].all()


def test_ring_is_pushed_from_outside(push, arena):
    # 12 pixels outside, 8 inside: the hole, 4 cm in radius, has room for the tool.
    ring = disc(12.0) & ~disc(8.0)
    assert signed_distance(ring)[48, 48] * PIXEL > push.clearance
    offered = plan([ring], push, arena)
    assert offered.legal.all()
    behind = -np.einsum(
        "kd,kd->k", offered.start[0], [direction_vector(k) for k in range(N_DIRECTIONS)]
    )
    np.testing.assert_allclose(behind, 0.06 + push.clearance, atol=PIXEL)
    np.testing.assert_allclose(offered.free[0], push.clearance, atol=PIXEL + push.walk)


def test_nothing_detected_offers_nothing(push, arena):
    empty = np.zeros((0, SIZE, SIZE))
    planner = PushPlanner(camera(), push, arena)
    offered = planner.plan(empty.astype(bool), empty.astype(np.float32))
    assert offered.start.shape == (0, 8, 2)
    assert offered.legal.shape == offered.free.shape == (0, 8)
    assert offered.legal.dtype == bool
