"""Physics that can be believed: nothing flies, sinks, creeps or rolls away."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import Envs
from scipy.spatial.transform import Rotation
from toys import BALL, BOX, CAN, TOYS, act, begin, lay_out

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.episode import draw_episode
from sdfgcn.sim.props import rolls

GRAVITY = 9.81
PUSHES, SLOW = 12, {"ur5e": 6}  # for each number of objects


def simulate(env: RearrangementEnv, seconds: float) -> None:
    physics = env.world.physics
    mujoco.mj_step(physics.model.ptr, physics.data.ptr, round(seconds / physics.timestep()))


def asleep(env: RearrangementEnv) -> np.ndarray:
    """[catalogue] whether each prop sleeps."""
    physics = env.world.physics
    return physics.data.tree_asleep[physics.model.body_treeid[env.world.task._bodies]] >= 0


@pytest.mark.parametrize("robot", sorted(ROBOTS))
@pytest.mark.parametrize("n", range(2, 7))
def test_random_pushes(env_of: Envs, robot, n):
    env = env_of(f"robot={robot}", "n_objects=3")
    task, config, rng = env.world.task, replace(env.config, n_objects=n), np.random.default_rng(n)
    touched = 0
    pushes = SLOW.get(robot, PUSHES)
    for i in range(pushes):
        if i % 4 == 0:
            td = begin(env, draw_episode(int(rng.integers(2**31)), env.world.catalogue, config))
            physics = env.world.physics
            poses = task.poses(physics)
        td = act(env, td, int(rng.choice(np.flatnonzero(td["action_mask"].numpy()))))
        after = env.last_step.after.poses
        assert np.isfinite(after).all() and np.isfinite(physics.data.qvel).all()
        travel = np.linalg.norm((after - poses)[:, :3], axis=1)
        assert travel.max() < env.config.push.length + 0.04
        assert (after[:, 2] > 0.0).all() and (after[:, 2] < 0.1).all()
        for model, pose in zip(env.episode_start.truth.objects, after, strict=True):
            corners = Rotation.from_quat(pose[3:], scalar_first=True).apply(
                np.concatenate(model.pieces)
            )
            assert corners[:, 2].min() + pose[2] > -0.001
        touched += travel.max() > 0.02
        # Half a second more: everything lies still and sleeps; then put it back.
        simulate(env, 0.5)
        assert np.linalg.norm((task.poses(physics) - after)[:, :3], axis=1).max() < 0.001
        assert asleep(env).all()
        task.set_poses(physics, after)
        poses = after
    assert touched > pushes / 2


def test_props_are_awake_while_pushed_and_asleep_after(toys_of: Envs):
    env = toys_of("gripper")
    lay_out(env, [BOX, BALL], [(-0.1, 0.1), (0.1, 0.1)])
    physics = env.world.physics
    # What does not lie still does not fall asleep.
    physics.data.qvel[env.world.task._qvel[[BOX, BALL], 0]] = 0.1
    simulate(env, 0.005)
    assert not asleep(env)[[BOX, BALL]].any()
    simulate(env, 0.5)
    assert asleep(env).all()
    # A nudge wakes one and not the other.
    physics.data.qvel[env.world.task._qvel[BOX][0]] = 0.1
    simulate(env, 0.01)
    assert asleep(env)[BALL] and not asleep(env)[BOX]


def test_slip_is_taken_out_after_the_push_and_not_in_it(toys_of: Envs, monkeypatch):
    env = toys_of("gripper", "env=table")
    sweeps, step = [], mujoco.mj_step

    def spy(model: mujoco.MjModel, data: mujoco.MjData, nstep: int = 1) -> None:
        sweeps.append(model.opt.noslip_iterations)
        step(model, data, nstep)

    monkeypatch.setattr(mujoco, "mj_step", spy)
    td = lay_out(env, [BALL], [(0.0, 0.1)])
    assert set(sweeps) == {5}
    sweeps.clear()
    act(env, td, 0)
    assert env.last_step.push.result.status == "done"
    assert sweeps[0] == 0 and sweeps == sorted(sweeps)
    # What is done to the world between pushes is done as when it comes to rest.
    assert env.world.physics.model.opt.noslip_iterations == 5


@pytest.mark.parametrize("toy", [BALL, CAN])
def test_what_rolls_stops_soon(toys_of: Envs, toy):
    env = toys_of("gripper")
    lay_out(env, [toy], [(-0.1, 0.1)])
    task, physics, speed, radius = env.world.task, env.world.physics, 0.2, 0.03
    pose = task.poses(physics)[0]
    # Rolling along x turns it about y; a free joint turns in its own frame.
    spin = Rotation.from_quat(pose[3:], scalar_first=True).inv().apply([0.0, speed / radius, 0.0])
    physics.data.qvel[task._qvel[toy]] = [speed, 0.0, 0.0, *spin]
    simulate(env, 3.0)
    distance = task.poses(physics)[0, 0] - pose[0]
    # Dry friction takes off c g / (1 + k) of speed a second: torque c m g, inertia k m r^2.
    share = 0.4 if toy == BALL else 0.5
    braking = env.config.physics.rolling_friction / radius * GRAVITY / (1.0 + share)
    assert 0.002 < distance < 0.10
    assert distance == pytest.approx(speed**2 / (2.0 * braking), rel=0.5)
    assert asleep(env)[toy]


def test_only_what_can_roll_is_braked():
    assert [rolls(model) for model in TOYS] == [False, False, True, True]


def test_a_sliding_box_stops_as_friction_says(toys_of: Envs):
    env = toys_of("gripper")
    lay_out(env, [BOX], [(-0.1, 0.1)])
    task, physics, speed = env.world.task, env.world.physics, 0.4
    start = task.poses(physics)[0, 0]
    physics.data.qvel[task._qvel[BOX][0]] = speed
    simulate(env, 1.0)
    distance = task.poses(physics)[0, 0] - start
    braking = env.config.physics.sliding_friction * GRAVITY
    assert distance == pytest.approx(speed**2 / (2.0 * braking), rel=0.15)
