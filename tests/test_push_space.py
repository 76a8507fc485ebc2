"""The space of pushes by hand: directions, actions, mirror images, and where a push starts."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from configs import real_config

from sdfgcn.config import ArenaConfig, PushConfig
from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.task.push_space import PushPlan, PushSpace

SIZE = 96
PIXEL = 0.005  # metres on the table, under the camera of these tests
ROWS, COLUMNS = np.indices((SIZE, SIZE))


@pytest.fixture(scope="module")
def push() -> PushConfig:
    """The real figures, but the picture read as a map of the table itself."""
    return replace(real_config("objects=household").env.push, plane_height=0.0)


@pytest.fixture(scope="module")
def arena() -> ArenaConfig:
    """The camera 1 m straight above the origin; the picture shows 48 cm, so a pixel is 5 mm."""
    return replace(
        real_config("objects=household").env.arena,
        camera_tilt=0.0,
        camera_fovy=float(np.degrees(2 * np.arctan(0.24))),
        camera_distance=1.0,
        camera_target=[0.0, 0.0],
    )


@pytest.fixture(scope="module", params=[8, 16])
def space(request: pytest.FixtureRequest, push: PushConfig, arena: ArenaConfig) -> PushSpace:
    return PushSpace(replace(push, directions=request.param), arena)


@pytest.fixture(scope="module")
def eight(push: PushConfig, arena: ArenaConfig) -> PushSpace:
    return PushSpace(push, arena)


@pytest.fixture(scope="module")
def sixteen(push: PushConfig, arena: ArenaConfig) -> PushSpace:
    return PushSpace(replace(push, directions=16), arena)


def ahead_of(space: PushSpace) -> np.ndarray:
    """[D, 2] the unit vectors of the directions."""
    return np.stack([np.cos(space.angles), np.sin(space.angles)], axis=-1)


# ------------------------------------------------------------------ directions and actions


def test_directions_are_evenly_apart(eight, sixteen):
    r = np.sqrt(0.5)
    wanted = [[1, 0], [r, r], [0, 1], [-r, r], [-1, 0], [-r, -r], [0, -1], [r, -r]]
    np.testing.assert_allclose(ahead_of(eight), wanted, atol=1e-12)
    # Every other one of 16 is one of 8; in between, 22.5 degrees from both.
    np.testing.assert_allclose(ahead_of(sixteen)[::2], wanted, atol=1e-12)
    degrees = np.degrees(sixteen.angles[[0, 1, 5, 15]])
    np.testing.assert_allclose(degrees, [0.0, 22.5, 112.5, 337.5], atol=1e-12)


def test_an_action_is_its_row_and_its_direction(space):
    n = space.n_directions
    assert (space.encode(0, 0), space.encode(0, n - 1), space.encode(2, 3)) == (0, n - 1, 2 * n + 3)
    assert space.decode(5 * n + 1) == (5, 1)
    actions = range(6 * n)
    assert [space.encode(*space.decode(action)) for action in actions] == list(actions)
    spec = space.spec(6)
    assert (spec.n, spec.shape, spec.dtype) == (6 * n, torch.Size([]), torch.int64)
    values = space.by_direction(torch.arange(2 * 6 * n).view(2, 6 * n))
    assert values.shape == (2, 6, n)
    assert values[1, 4, 3] == 6 * n + space.encode(4, 3)


@pytest.mark.parametrize(
    ("offset", "ranked"),
    [
        ((1.0, 0.0), 0),
        ((0.0, 1.0), 2),
        ((-1.0, 0.0), 4),
        ((-1.0, -1e-9), 4),
        ((-1.0, -1.0), 5),
        ((0.0, -1.0), 6),
        ((1.0, -0.1), 0),
        ((1.0, 0.41), 0),  # 22.3 degrees
        ((1.0, 0.42), 1),  # 22.8 degrees
    ],
)
def test_nearest_of_8(eight, offset, ranked):
    assert eight.nearest(np.array(offset))[0] == ranked


@pytest.mark.parametrize(
    ("offset", "ranked"),
    [
        ((1.0, 0.0), 0),
        ((1.0, 0.19), 0),  # 10.8 degrees
        ((1.0, 0.21), 1),  # 11.9 degrees
        ((1.0, 0.42), 1),
        ((0.0, 1.0), 4),
        ((-1.0, -0.42), 9),  # 202.8 degrees
        ((1.0, -0.3), 15),  # 343.3 degrees
    ],
)
def test_nearest_of_16(sixteen, offset, ranked):
    assert sixteen.nearest(np.array(offset))[0] == ranked


def test_directions_are_ranked_by_angle(eight, sixteen):
    # At 10 degrees: 0 (10 away), 45 (35), 315 (55), 90 (80), 270 (100), 135, 225, 180.
    angle = np.radians(10)
    offset = np.array([np.cos(angle), np.sin(angle)])
    assert eight.nearest(offset).tolist() == [0, 1, 7, 2, 6, 3, 5, 4]
    # 0 (10 away), 22.5 (12.5), 337.5 (32.5), 45 (35), 315 (55), 67.5 (57.5) ...
    assert sixteen.nearest(offset).tolist()[:6] == [0, 1, 15, 2, 14, 3]
    assert sorted(sixteen.nearest(offset)) == list(range(16))


# ------------------------------------------------------------------ mirror images and turns


def test_mirrored_at_x_0_by_hand(eight, sixteen):
    # Right and left change places, up and down stay: 180 degrees less the angle.
    assert eight.mirrored_action(torch.arange(8)).tolist() == [4, 3, 2, 1, 0, 7, 6, 5]
    wanted = [8, 7, 6, 5, 4, 3, 2, 1, 0, 15, 14, 13, 12, 11, 10, 9]
    assert sixteen.mirrored_action(torch.arange(16)).tolist() == wanted
    assert sixteen.mirrored_action(torch.tensor(3 * 16 + 1)) == 3 * 16 + 7


def test_a_mirrored_direction_heads_the_other_way_in_x(space):
    ahead = ahead_of(space)
    mirrored = space.mirrored_action(torch.arange(space.n_directions)).numpy()
    np.testing.assert_allclose(ahead[mirrored], ahead * [-1.0, 1.0], atol=1e-12)


def test_mirrored_values_go_with_mirrored_actions(space):
    n = 3 * space.n_directions
    actions = torch.arange(n)
    values = torch.rand(2, n, generator=torch.Generator().manual_seed(0))
    mirrored = space.mirrored(values)
    assert torch.equal(mirrored[:, space.mirrored_action(actions)], values)
    assert torch.equal(space.mirrored(mirrored), values)
    assert not torch.equal(mirrored, values)


def test_turned_by_hand(eight, sixteen):
    # What headed right heads 45 degrees further after one step of eight.
    values = torch.zeros(1, 16)
    values[0, 8 + 0], values[0, 8 + 7] = 1.0, 2.0
    assert torch.nonzero(eight.turned(values, 1)[0]).flatten().tolist() == [8, 9]
    assert eight.turned(values, 1)[0, [8, 9]].tolist() == [2.0, 1.0]
    # A quarter turn is two steps of 8, and four of 16.
    assert eight.turned(torch.arange(8), 2).tolist() == [6, 7, 0, 1, 2, 3, 4, 5]
    assert sixteen.turned(torch.arange(16), 4).tolist() == [*range(12, 16), *range(12)]


# ------------------------------------------------------------------ masks drawn by hand


def rectangle(rows: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
    """The mask of pixels with row and column in the half-open ranges."""
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[slice(*rows), slice(*columns)] = True
    return mask


def disc(radius: float) -> np.ndarray:
    """Pixels whose centre lies within `radius` pixels of the picture's middle."""
    return np.hypot(ROWS + 0.5 - 48, COLUMNS + 0.5 - 48) <= radius


def fields(masks: np.ndarray) -> np.ndarray:
    return SdfTransform("fmm", SIZE).fields(masks)


def plan(masks: list[np.ndarray], space: PushSpace) -> PushPlan:
    return space.plan(np.stack(masks), fields(np.stack(masks)))


MIDDLE = rectangle((40, 56), (40, 56))  # 8 cm square around the origin


@pytest.mark.parametrize(
    ("mask", "center"),
    [
        (MIDDLE, (0.0, 0.0)),
        (rectangle((0, 2), (94, 96)), (0.235, 0.235)),  # top right: far and to the right
        (rectangle((47, 49), (10, 30)), (-0.14, 0.0)),
    ],
)
def test_centre_of_a_mask(eight, mask, center):
    np.testing.assert_allclose(eight.centers(mask[None]), [center], atol=1e-9)
    np.testing.assert_allclose(plan([mask], eight).center, [center], atol=1e-9)


def test_start_lies_behind_by_half_a_side_and_the_clearance(push, space):
    offered = plan([MIDDLE], space)
    assert offered.legal.all()
    detected = np.array([True])
    for k, ahead in enumerate(ahead_of(space)):
        # From the middle to the edge: half a side, or half a diagonal, or in between.
        edge = 0.04 / np.abs(ahead).max()
        # The clearance is that to the nearest point: straight ahead, at a corner, or beside.
        slant = abs(np.degrees(space.angles[k]) % 90 - 45) == pytest.approx(22.5)
        wanted = (0.04 + push.clearance) / np.abs(ahead).max() if slant else edge + push.clearance
        start = offered.start[0, k]
        # The search walks in steps, and a corner is worn off by a pixel.
        behind = -start @ ahead
        assert -PIXEL < behind - wanted < push.search_step
        assert abs(start @ [-ahead[1], ahead[0]]) < 1e-9
        # The surface is a step of the search away from where the tool will meet it.
        assert -PIXEL < offered.free[0, k] - (behind - edge) < PIXEL + push.search_step
        command = space.command(offered, detected, 0, k)
        np.testing.assert_array_equal(command.start, start)
        assert (command.angle, command.free) == (space.angles[k], offered.free[0, k])


def test_tool_fits_between_neighbours_only_if_there_is_room(push, eight):
    # A neighbour to the left, 8 cm wide, from -18 cm or from -16 cm on.
    far, near = rectangle((40, 56), (12, 28)), rectangle((40, 56), (16, 33))
    # 6 cm between the two are enough for 1.9 cm on either side; 3.5 cm are not.
    roomy, tight = plan([MIDDLE, far], eight), plan([MIDDLE, near], eight)
    alone = plan([MIDDLE], eight)
    np.testing.assert_array_equal(roomy.start[0, 0], alone.start[0, 0])
    # Behind the neighbour then, whose far edge is at -16 cm, and its surface comes first.
    behind = -tight.start[0, 0, 0]
    assert -PIXEL < behind - (0.16 + push.clearance) < push.search_step
    assert tight.free[0, 0] == pytest.approx(behind - 0.16, abs=PIXEL + push.search_step)
    # The other way nothing has changed.
    np.testing.assert_array_equal(tight.start[0, 4], alone.start[0, 4])
    assert tight.free[0, 4] == alone.free[0, 4]
    # The neighbour itself: pushed to the left it needs room on its right, where the square is.
    assert tight.start[1, 4, 0] > 0.04 + push.clearance - PIXEL


def test_no_push_from_beyond_the_tools_bounds(push, arena):
    # The tool may go 5 cm to the left of the middle; behind the square it would need 5.9 cm.
    bounded = replace(arena, reach_x=[-0.05, 0.35])
    offered = plan([MIDDLE], PushSpace(push, bounded))
    assert offered.legal[0].tolist() == [False, False, True, True, True, True, True, False]
    assert np.isnan(offered.start[0, [0, 1, 7]]).all()
    assert np.isfinite(offered.start[0, 2:7]).all()


def test_no_push_from_beyond_the_picture(eight):
    # 1 cm from the picture's left edge: no clearance there, and what lies beyond is unknown.
    offered = plan([rectangle((40, 56), (2, 18))], eight)
    assert not offered.legal[0, [0, 1, 7]].any()
    assert offered.legal[0, 2:7].all()


def test_ring_is_pushed_from_outside(push, eight):
    # 12 pixels outside, 8 inside: the hole, 4 cm in radius, has room for the tool.
    ring = disc(12.0) & ~disc(8.0)
    assert fields(ring[None])[0, 48, 48] * PIXEL > push.clearance
    offered = plan([ring], eight)
    assert offered.legal.all()
    behind = -np.einsum("kd,kd->k", offered.start[0], ahead_of(eight))
    np.testing.assert_allclose(behind, 0.06 + push.clearance, atol=PIXEL)
    np.testing.assert_allclose(offered.free[0], push.clearance, atol=PIXEL + push.search_step)


def test_nothing_detected_offers_nothing(space):
    n, empty = space.n_directions, np.zeros((0, SIZE, SIZE))
    offered = space.plan(empty.astype(bool), empty.astype(np.float32))
    assert offered.start.shape == (0, n, 2)
    assert offered.center.shape == (0, 2)
    assert offered.legal.shape == offered.free.shape == (0, n)
    assert offered.legal.dtype == bool


# ------------------------------------------------------------------ rows and legal pushes


def test_a_command_is_that_of_its_row(space):
    # The second detection is in row 2; rows 1 and 3 hold nothing.
    other = rectangle((10, 20), (10, 20))
    offered, detected = plan([MIDDLE, other], space), np.array([True, False, True, False])
    for row, node in ((0, 0), (2, 1)):
        command = space.command(offered, detected, row, 3)
        np.testing.assert_array_equal(command.start, offered.start[node, 3])
        assert command.free == offered.free[node, 3] > 0.0
    # Also beyond the rows that were ever seen.
    for row in (1, 3, 7):
        command = space.command(offered, detected, row, 3)
        assert np.isnan(command.start).all() and command.free == 0.0
        assert command.angle == space.angles[3]


def test_legal_pushes_by_row(push, arena):
    # As above, the tool cannot get behind what is pushed to the right.
    space = PushSpace(push, replace(arena, reach_x=[-0.05, 0.35]))
    offered = plan([MIDDLE], space)
    mask = space.by_direction(space.action_mask(offered, np.array([False, True]), 4))
    assert mask.dtype == torch.bool
    assert mask[1].tolist() == [False, False, True, True, True, True, True, False]
    assert not mask[[0, 2, 3]].any()


def test_one_push_is_always_legal(space):
    n = space.n_directions
    nothing = space.plan(np.zeros((0, SIZE, SIZE), bool), np.zeros((0, SIZE, SIZE), np.float32))
    # Where nothing is detected, row 0 stands in.
    for rows in (np.zeros(0, dtype=bool), np.zeros(3, dtype=bool)):
        mask = space.by_direction(space.action_mask(nothing, rows, 3))
        assert mask.shape == (3, n)
        assert mask[0].all() and not mask[1:].any()
    # What is boxed in may be tried in vain: everything that is detected, and nothing else.
    free = plan([MIDDLE, disc(4.0)], space)
    boxed_in = replace(free, legal=np.zeros_like(free.legal))
    mask = space.by_direction(space.action_mask(boxed_in, np.array([True, False, True]), 4))
    assert mask.all(dim=-1).tolist() == [True, False, True, False]
    assert mask.any(dim=-1).tolist() == [True, False, True, False]
