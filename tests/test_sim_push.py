"""Every robot's tool goes where it is sent, and does to objects what a push should do."""

from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from conftest import Envs
from tool import Fingertips
from toys import BALL, BOX, CAN, SLAB, ahead_of, angle_of, lay_out, push

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.push import ramped
from sdfgcn.sim.robots.gripper import FloatingGripper
from sdfgcn.sim.robots.robot import Unreachable

DIRECTIONS = range(8)
MIDDLE = np.array([0.02, 0.08])  # metres
FINGERS = 0.01  # metres from the middle of the tool to its front
BUMPED = 0.015  # metres that repeated impacts send a box ahead of the tool, at most


@pytest.fixture(scope="module", params=sorted(ROBOTS))
def env(request: pytest.FixtureRequest, toys_of: Envs) -> RearrangementEnv:
    return toys_of(request.param)


@pytest.fixture(scope="module")
def tips(env: RearrangementEnv) -> Fingertips:
    lay_out(env, [BOX], [MIDDLE])
    return Fingertips(env.world.physics, env.world.task.robot)


def behind(direction: int, distance: float) -> np.ndarray:
    return MIDDLE - distance * ahead_of(direction)


# ------------------------------------------------------------------ the tool


def test_tool_is_where_the_joints_are_solved_for(env, tips):
    robot, physics = env.world.task.robot, env.world.physics
    arena, approach = env.config.arena, env.config.push.approach
    for x in (*arena.reach_x, 0.1):
        for y in (*arena.reach_y, 0.05):
            for z, yaw in ((0.004, -np.pi / 2), (0.004 + approach, np.pi / 4), (0.004, 0.3)):
                robot.place(physics, robot.solve(np.array([x, y, z, yaw])))
                physics.forward()
                np.testing.assert_allclose(tips.position(physics.data.ptr), [x, y, z], atol=0.0005)
                # At yaw 0 the fingers stand side by side along x (or its opposite).
                side = np.array([np.cos(yaw), np.sin(yaw)])
                assert abs(tips.across(physics.data.ptr) @ side) > np.cos(0.01)


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_tool_follows_the_path(env, tips, direction):
    """Straight down, straight ahead at the push height, straight up."""
    lay_out(env, [BOX], [(-0.2, -0.1)])
    ahead, config = ahead_of(direction), env.config.push
    begin = behind(direction, 0.05)
    with tips.followed() as followed:
        result = push(env, begin, direction, free=0.04).result
    assert result.status == "no_contact"
    np.testing.assert_allclose(result.start, [*begin, config.height], atol=1e-9)
    np.testing.assert_allclose(result.end[:2], begin + 0.06 * ahead, atol=1e-9)

    # Before and after, the tool jumps: only what is near the line belongs to the push.
    path, across = np.array(followed.path), np.array(followed.across)
    along, aside = (path[:, :2] - begin) @ ahead, (path[:, :2] - begin) @ [-ahead[1], ahead[0]]
    near = (np.abs(along - 0.03) < 0.04) & (np.abs(aside) < 0.01) & (path[:, 2] < 0.13)
    first, last = np.flatnonzero(near)[[0, -1]]
    assert near[first : last + 1].all()
    path, along, aside = path[first:last, 2], along[first:last], aside[first:last]
    low = np.flatnonzero(path < config.height + 0.003)
    work = slice(low[0], low[-1] + 1)
    down, up = slice(0, low[0]), slice(low[-1] + 1, None)

    close = 0.001
    if env.world.task.robot.teleports:
        assert low[0] == 0  # it is put there
    else:
        assert path[0] == pytest.approx(config.height + config.approach, abs=0.004)  # one step on
        assert len(path[down]) > 150 * config.approach and (np.diff(path[down]) < close).all()
        assert np.abs(along[down]).max() < close and np.abs(aside[down]).max() < close
    assert path[work].min() > config.height - min(close, 0.003)
    assert np.median(path[work]) == pytest.approx(config.height, abs=0.002)
    assert along[work].min() > -close and np.abs(aside[work]).max() < close
    assert (np.diff(path[up]) > 0.0).all() and path[up][-1] > 0.06
    # It backs off before it rises.
    assert along[work].max() == pytest.approx(0.06, abs=close)
    # Straight up as the joints go, which for an arm is not quite straight.
    np.testing.assert_allclose(
        along[up], 0.06 - config.retreat, atol=0.002 if env.world.task.robot.teleports else 0.010
    )
    # The fingers stand side by side across the push.
    assert np.abs(across[first:last] @ ahead).max() < 0.05


def test_unreachable_pose_is_said_so(env):
    if isinstance(env.world.task.robot, FloatingGripper):
        pytest.skip("a floating gripper reaches everything")
    with pytest.raises(Unreachable, match="no joint positions"):
        env.world.task.robot.solve(np.array([1.5, 0.0, 0.1, 0.0]))


def test_tool_stays_within_its_bounds(env, tips):
    lay_out(env, [BOX], [MIDDLE])
    result = push(env, (0.30, 0.38), 1, free=0.0).result
    # y = 0.40 is reached after 2 cm, x = 0.35 would be after 5 cm.
    np.testing.assert_allclose(result.end[:2], [0.32, 0.40], atol=1e-9)


# ------------------------------------------------------------------ what it does to objects


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize("toy", [BOX, SLAB])
def test_push_moves_a_box_until_the_tool_stops(env, toy, direction):
    # The toys are 6 cm deep in x or y; turned so that a face meets the tool squarely.
    half, quarter = (0.03, 0.0) if toy == BOX else (0.03, np.pi / 2)
    lay_out(env, [toy], [MIDDLE], yaw=angle_of(direction) + quarter)
    done = push(env, behind(direction, half + 0.03), direction, free=0.03)
    assert done.result.status == "done"
    distance = np.linalg.norm(done.moved[0, :2])
    # 6 cm from the start, of which the fingers are in contact after 2 cm.
    assert -0.002 < distance - (env.config.push.length - 0.03 + FINGERS) < BUMPED
    assert done.moved[0, :2] @ ahead_of(direction) / distance > np.cos(np.radians(10))
    assert abs(done.moved[0, 2]) < 0.0005


@pytest.fixture(scope="module", params=sorted(ROBOTS))
def measured(request: pytest.FixtureRequest, toys_of: Envs) -> Callable[[str], RearrangementEnv]:
    """The env whose pushes count from where `length_from` says."""
    return lambda length_from: toys_of(request.param, f"env.push.length_from={length_from}")


@pytest.mark.parametrize(
    ("length_from", "free", "tool", "box"),
    [
        # Whatever the picture says, 6 cm, of which 2 cm are free.
        ("start", 0.00, 0.06, 0.04),
        ("start", 0.06, 0.06, 0.04),
        # 6 cm more than the picture says is free: 3 cm, as it is, and wrong by 3 cm either way.
        ("surface", 0.00, 0.06, 0.04),
        ("surface", 0.03, 0.09, 0.07),
        ("surface", 0.06, 0.12, 0.10),
        # Whatever the picture says, 6 cm after the 2 cm that are free.
        ("touch", 0.00, 0.08, 0.06),
        ("touch", 0.06, 0.08, 0.06),
    ],
)
def test_length_counts_from(measured, length_from, free, tool, box):
    """The tool starts 6 cm behind the middle of a box of 6 cm, and its front is 1 cm ahead."""
    env = measured(length_from)
    lay_out(env, [BOX], [MIDDLE])
    done = push(env, behind(0, 0.06), 0, free)
    assert done.result.status == "done"
    way = (done.result.end - done.result.start)[0]
    assert way == pytest.approx(tool, abs=0.002 if length_from == "touch" else 1e-9)
    assert box - 0.002 < done.moved[0, 0] < box + BUMPED


@pytest.mark.parametrize(
    ("length_from", "way"), [("start", 0.06), ("surface", 0.10), ("touch", 0.10)]
)
def test_without_a_touch_it_counts_from_the_surface_in_the_picture(measured, length_from, way):
    env = measured(length_from)
    lay_out(env, [BOX], [(-0.2, -0.1)])
    result = push(env, MIDDLE, 2, free=0.04).result
    assert result.status == "no_contact"
    np.testing.assert_allclose(result.end[:2], MIDDLE + np.array([0.0, way]), atol=1e-9)


def test_no_push_throws_an_object(env):
    """The tool leaves what it has pushed behind; thrown up, it would go 8 to 12 cm."""
    furthest = 0.0
    for toy in (BOX, SLAB, BALL, CAN):
        for direction in DIRECTIONS:
            lay_out(env, [toy], [(0.0, 0.28)], yaw=0.4)
            begin = np.array([0.0, 0.28]) - 0.075 * ahead_of(direction)
            done = push(env, begin, direction, free=0.04)
            assert done.result.status == "done"
            furthest = max(furthest, np.linalg.norm(done.moved[0]))
    assert 0.04 < furthest < env.config.push.length + 0.02


def test_push_through_thin_air_moves_nothing(env):
    lay_out(env, [BOX, BALL], [MIDDLE, (-0.2, 0.2)])
    done = push(env, behind(2, 0.2), 2, free=0.0)
    assert done.result.status == "no_contact"
    assert np.abs(done.moved[:, :2]).max() < 1e-4
    assert np.abs(done.moved[:, 2]).max() < 2e-4  # they sink into their contacts


@pytest.mark.parametrize("toy", [BOX, SLAB, BALL, CAN])
@pytest.mark.parametrize("direction", [0, 3])
def test_descent_onto_an_object_is_given_up(env, toy, direction):
    lay_out(env, [toy], [MIDDLE])
    done = push(env, MIDDLE, direction, free=0.02)
    assert done.result.status == "blocked"
    assert np.abs(done.moved).max() < 0.001
    np.testing.assert_array_equal(done.result.end, done.result.start)


@pytest.mark.parametrize(
    "start", [(0.36, 0.1), (0.0, 0.41), (-0.36, 0.0), (0.0, -0.23), (np.nan, np.nan), (0.0, np.nan)]
)
def test_start_out_of_bounds_moves_nothing(env, start):
    lay_out(env, [BOX, BALL], [MIDDLE, (-0.2, 0.2)])
    done = push(env, start, 4, free=0.02)
    assert done.result.status == "unreachable"
    np.testing.assert_array_equal(done.after, done.before)


def test_robots_push_alike(env_of: Envs):
    """The issue's figures: within 5 mm and 10 degrees on average, over random pushes."""
    envs = [env_of(f"robot={robot}") for robot in sorted(ROBOTS)]
    rng = np.random.default_rng(0)
    moves = []
    for seed in range(18):
        legal = [env.reset_episode(seed)["action_mask"].numpy() for env in envs]
        np.testing.assert_array_equal(legal[0], legal[1])
        start, space = envs[0].episode_start.start, envs[0].push_space
        rows = start.scene.node_mask.numpy()
        seen = start.scene.masks.numpy()[rows], start.scene.sdf.numpy()[rows]
        plan = space.plan(*seen)
        for action in rng.choice(np.flatnonzero(legal[0]), size=3, replace=False):
            slot, direction = space.decode(int(action))
            command = space.command(plan, rows, slot, direction)
            pair = []
            for env in envs:
                env.world.task.set_poses(env.world.physics, start.poses)
                pair.append(push(env, command.start, direction, command.free).moved[slot, :2])
            moves.append(pair)
    assert len(moves) >= 50
    apart = np.linalg.norm(np.diff(moves, axis=1)[:, 0], axis=-1)
    lengths = np.linalg.norm(moves, axis=-1)
    assert apart.mean() < 0.005
    assert abs(np.diff(lengths.mean(axis=0))) < 0.005
    both = lengths.min(axis=1) > 0.01  # a shorter move has no direction to speak of
    assert both.sum() >= 45
    units = np.array(moves)[both] / lengths[both][..., None]
    angles = np.degrees(np.arccos(np.clip((units[:, 0] * units[:, 1]).sum(axis=-1), -1, 1)))
    assert angles.mean() < 10


# ------------------------------------------------------------------ starting and stopping


def test_ramps_by_hand():
    # 0.1 s at 10 m/s2 to 1 m/s over 0.05 m, 0.1 s at that speed, 0.1 s back to rest.
    way = ramped(0.2, speed=1.0, acceleration=10.0, tick=0.05)
    np.testing.assert_allclose(way, [0.0, 0.0125, 0.05, 0.1, 0.15, 0.1875, 0.2], atol=1e-12)
    # Already at that speed: 0.15 s, and 0.1 s to rest.
    way = ramped(0.2, 1.0, 10.0, 0.05, from_rest=False)
    np.testing.assert_allclose(way, [0.0, 0.05, 0.1, 0.15, 0.1875, 0.2], atol=1e-12)
    # Too short for 1 m/s: 0.1 m in twice 0.1 s.
    np.testing.assert_allclose(ramped(0.1, 2.0, 10.0, 0.1), [0.0, 0.05, 0.1], atol=1e-12)
    # At speed from end to end.
    way = ramped(0.2, 1.0, 10.0, 0.1, from_rest=False, to_rest=False)
    np.testing.assert_allclose(way, [0.0, 0.1, 0.2], atol=1e-12)
    np.testing.assert_array_equal(ramped(0.0, 1.0, 10.0, 0.05), [0.0, 0.0])


@pytest.mark.parametrize("seed", range(3))
def test_drives_do_not_chatter(env, seed):
    """Where torque limits cut in, the arm's drives went to and fro between them at every step."""
    lay_out(env, [BOX], [(-0.2, -0.1)])
    physics, robot = env.world.physics, env.world.task.robot
    limits = physics.model.actuator_forcerange[robot.drive_ids, 1]
    shares, step = [], mujoco.mj_step

    def spy(model: mujoco.MjModel, data: mujoco.MjData, nstep: int = 1) -> None:
        for _ in range(nstep):
            step(model, data)
            shares.append(data.actuator_force[robot.drive_ids] / limits)

    rng = np.random.default_rng(seed)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mujoco, "mj_step", spy)
        done = push(env, rng.uniform([0.0, 0.0], [0.2, 0.3]), int(rng.integers(8)), free=0.04)
    assert done.result.status == "no_contact" and len(shares) > 50
    full = np.array(shares)
    turned = (np.abs(np.diff(full, axis=0)) > 1.5).any(axis=1)  # from one limit to the other
    assert turned.sum() <= 2


def test_descent_that_touches_is_given_up(toys_of: Envs, monkeypatch):
    """Should the way not be free after all, as for an arm that strays from it."""
    env = toys_of("ur5e")
    lay_out(env, [BOX], [MIDDLE])
    monkeypatch.setattr(env.world.task._primitive, "_free", lambda *_: True)
    done = push(env, MIDDLE, 0, free=0.02)
    assert done.result.status == "blocked"
    assert np.linalg.norm(done.moved) < 0.01
