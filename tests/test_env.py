"""What TorchRL, and anyone who trains or evaluates with it, may rely on."""

import itertools
import json

import numpy as np
import pytest
import torch
from configs import real_config
from conftest import Envs
from tensordict import TensorDictBase
from torchrl.envs.utils import check_env_specs
from toys import BALL, BOX, act, assert_equal, lay_out, leaves

from sdfgcn.agents import build_agent
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.registry import ROBOTS

SIZE = 96
ROWS = 8
DIRECTIONS = 8


@pytest.fixture(scope="module")
def env(env_of: Envs) -> RearrangementEnv:
    return env_of("robot=gripper", "n_objects=3")


def rollout(env: RearrangementEnv, td: TensorDictBase, steps: int, seed: int = 0) -> list[dict]:
    """Legal random pushes; everything that the environment reports."""
    rng = np.random.default_rng(seed)
    seen = [snapshot(env, td)]
    for _ in range(steps):
        td = act(env, td, int(rng.choice(np.flatnonzero(td["action_mask"].numpy()))))
        seen.append(snapshot(env, td))
        if td["done"]:
            break
    return seen


def snapshot(env: RearrangementEnv, td: TensorDictBase) -> dict:
    moment = env.last_step.after if env.last_step else env.episode_start.start
    return leaves(td) | {"poses": torch.from_numpy(moment.poses)}


def assert_same(first: list[dict], second: list[dict]) -> None:
    assert len(first) == len(second)
    for one, other in zip(first, second, strict=True):
        assert one.keys() == other.keys()
        for key, value in one.items():
            assert torch.equal(value, other[key]), key


# ------------------------------------------------------------------ specs


@pytest.mark.parametrize("pixels", [False, True])
@pytest.mark.parametrize("robot", sorted(ROBOTS))
def test_specs(env_of: Envs, robot, pixels):
    overrides = ["env.pixels=true"] if pixels else []
    env = env_of(f"robot={robot}", "n_objects=3", *overrides)
    check_env_specs(env)
    td = env.reset_episode(0)
    for _ in range(2):
        assert td["scene", "sdf"].shape == td["goal", "sdf"].shape == (ROWS, SIZE, SIZE)
        assert ("pixels" in td) is ("goal_pixels" in td) is pixels
        if pixels:
            assert td["pixels"].shape == (SIZE, SIZE, 3) and td["pixels"].dtype == torch.uint8
            # The goal is another picture, of the same table.
            assert (td["pixels"] != td["goal_pixels"]).any()
            assert td["pixels"].float().std() > 10
        td = act(env, td, int(env.rand_action(td.clone())["action"]))
    assert env.action_spec.n == ROWS * DIRECTIONS


def test_pixels_are_only_rendered_on_demand(env):
    env.reset_episode(0)
    assert env.episode_start.start.pixels is None and env.episode_start.goal.pixels is None
    env.record = True
    try:
        td = env.reset_episode(0)
        act(env, td, 63)
    finally:
        env.record = False
    for moment in (env.episode_start.start, env.episode_start.goal, env.last_step.after):
        assert moment.pixels.shape == (SIZE, SIZE, 3)
    # An object has another colour than the table around it.
    masks, pixels = env.episode_start.start.scene.masks[:3].numpy(), env.episode_start.start.pixels
    mask, table = masks[0], ~masks.any(axis=0)
    assert np.abs(pixels[mask].mean(axis=0) - pixels[table].mean(axis=0)).max() > 20


def test_rows_without_an_object_are_zero(env):
    td = env.reset_episode(1)
    for _ in range(2):
        assert td["scene", "node_mask"].tolist() == [True] * 3 + [False] * 5
        assert td["goal", "node_mask"].tolist() == [True] * 3 + [False] * 5
        for key in itertools.product(("scene", "goal"), ("sdf", "center", "position")):
            assert (td[key][3:] == 0).all(), key
            assert (td[key][:3].flatten(1) != 0).any(1).all(), key
        assert td["matched"].tolist() == [True] * 3 + [False] * 5
        assert not td["action_mask"].view(ROWS, DIRECTIONS)[3:].any()
        td = act(env, td, int(torch.nonzero(td["action_mask"])[0]))


def test_observation_tells_what_the_scene_holds(env):
    td = env.reset_episode(2)
    start = env.episode_start
    np.testing.assert_allclose(td["scene", "position"][:3], start.start.poses[:, :2], atol=1e-6)
    np.testing.assert_allclose(td["goal", "position"][:3], start.goal.poses[:, :2], atol=1e-6)
    assert not torch.equal(td["scene", "sdf"], td["goal", "sdf"])
    # Negative just where the mask is.
    for key, view in (("scene", env.world.look()), ("goal", env.world.look_at_goal())):
        np.testing.assert_array_equal(td[key, "sdf"][:3].numpy() < 0, view.true_masks())
    assert td["pushes"].item() == 0 and not td["success"].item()
    assert td["n_objects"].item() == start.n_objects == 3
    assert start.seed == 2 and len(start.truth.objects) == 3


# ------------------------------------------------------------------ actions


def test_action_index_is_object_times_8_plus_direction(env):
    for slot, direction in ((0, 1), (1, 6), (2, 3)):
        # An episode where this push is legal and nothing else is in its way.
        for seed in range(20):
            td = env.reset_episode(seed)
            action = slot * DIRECTIONS + direction
            others = np.delete(env.episode_start.start.poses[:, :2], slot, axis=0)
            apart = np.linalg.norm(others - env.episode_start.start.poses[slot, :2], axis=1).min()
            if td["action_mask"][action] and apart > 0.2:
                break
        before = env.episode_start.start.poses
        act(env, td, action)
        record = env.last_step
        assert (record.push.row, record.push.direction) == (slot, direction)
        assert record.push.angle == pytest.approx(direction * np.pi / 4)
        assert record.push.result.status == "done" and record.index == 1
        moved = (record.after.poses - before)[:, :2]
        lengths = np.linalg.norm(moved, axis=1)
        assert lengths[slot] > 0.03 and np.delete(lengths, slot).max() < 1e-3
        angle = np.degrees(np.arctan2(moved[slot, 1], moved[slot, 0]))
        assert abs((angle - 45 * direction + 180) % 360 - 180) < 25


def test_illegal_actions_move_nothing_and_cost_a_step(env):
    td = env.reset_episode(3)
    before = env.episode_start.start
    # The last slot, and the first one without an object.
    for i, action in enumerate((ROWS * DIRECTIONS - 1, 3 * DIRECTIONS), start=1):
        td = act(env, td, action)
        assert env.last_step.push.result.status == "unreachable"
        np.testing.assert_array_equal(env.last_step.after.poses, before.poses)
        assert torch.equal(env.last_step.after.scene.masks, before.scene.masks)
        assert td["reward"].item() == pytest.approx(-0.02)
        assert td["pushes"].item() == i and not td["done"].item()


def test_push_without_a_start_moves_nothing(toys_of: Envs):
    """3 cm of box and 1.9 cm of clearance behind x = -0.305 is beyond the tool's -0.35."""
    toys = toys_of("gripper")
    td = lay_out(toys, [BOX, BALL], [(-0.305, 0.1), (0.1, 0.1)])
    legal = td["action_mask"].view(ROWS, DIRECTIONS)
    assert not legal[0, [0, 1, 7]].any() and legal[0, 2:7].all() and legal[1].all()
    before = toys.world.poses()
    for direction in (0, 1, 7):
        td = act(toys, td, direction)
        assert toys.last_step.push.result.status == "unreachable"
        assert toys.last_step.push.row == 0
        np.testing.assert_array_equal(toys.last_step.after.poses, before)


def test_samples_are_legal(env):
    for seed in range(10):
        td = env.reset_episode(seed)
        assert 0 < td["action_mask"].sum() <= 3 * DIRECTIONS
        for _ in range(5):
            assert td["action_mask"][env.rand_action(td.clone())["action"]]


def test_truncated_at_the_step_limit(env_of: Envs):
    env = env_of("robot=gripper", "n_objects=2", "env.pushes_per_object=2")
    td = env.reset_episode(0)
    for push in range(1, 5):
        td = act(env, td, 63)
        assert td["pushes"].item() == env.last_step.index == push
        assert not td["terminated"].item()
        assert td["truncated"].item() is td["done"].item() is (push == 4)
        assert env.last_step.truncated is (push == 4)


# ------------------------------------------------------------------ one seed, one trajectory


def test_same_seed_same_trajectory_in_another_environment(env):
    # In this one, episodes have been played before.
    first = rollout(env, env.reset_episode(11), 8)
    again = rollout(env, env.reset_episode(11), 8)
    assert_same(first, again)
    other = RearrangementEnv(env.config, seed=99)
    try:
        assert_same(first, rollout(other, other.reset_episode(11), 8))
        # Restored into an environment that has never played anything else.
        other.set_seed(5)
        env.set_seed(5)
        assert_same(rollout(env, env.reset(), 2), rollout(other, other.reset(), 2))
        assert_same(rollout(env, env.reset(), 2), rollout(other, other.reset(), 2))
    finally:
        other.close()
    assert not torch.equal(env.reset_episode(12)["scene", "sdf"], first[0]["scene", "sdf"])


def test_seeded_episodes_differ_from_each_other(env):
    env.set_seed(5)
    seeds = []
    for _ in range(3):
        env.reset()
        seeds.append(env.episode_start.seed)
    assert len(set(seeds)) == 3
    # An episode of one's own choice does not disturb the sequence.
    env.set_seed(5)
    env.reset_episode(123)
    again = []
    for _ in range(3):
        env.reset()
        again.append(env.episode_start.seed)
    assert again == seeds


def test_saved_state_goes_on_bit_for_bit(env):
    td = env.reset_episode(21)
    for _ in range(3):
        td = act(env, td, int(torch.nonzero(td["action_mask"])[0]))
    state = env.save_state()
    original = rollout(env, td, 5)[1:]
    following = env.reset()["scene", "sdf"]
    # Later, in the same environment, after another episode.
    rollout(env, env.reset_episode(4), 3)
    back = env.restore_state(state)
    assert back["pushes"].item() == 3
    assert_equal(back, td)
    assert_same(original, rollout(env, back, 5)[1:])
    # On disk and back, into a new environment; the episodes after it are the same too.
    other = RearrangementEnv(env.config, seed=77)
    try:
        restored = other.restore_state(json.loads(json.dumps(state)))
        assert_same(original, rollout(other, restored, 5)[1:])
        assert torch.equal(other.reset()["scene", "sdf"], following)
    finally:
        other.close()


def test_saving_changes_nothing_and_restoring_gives_the_observation_back(env):
    td = env.reset_episode(31)
    rng = np.random.default_rng(2)
    actions = []
    for _ in range(4):
        actions.append(int(rng.choice(np.flatnonzero(td["action_mask"].numpy()))))
        td = act(env, td, actions[-1])
        env.save_state()
    undisturbed = env.reset_episode(31)
    for i, action in enumerate(actions):
        undisturbed = act(env, undisturbed, action)
        if i == 1:
            back = env.restore_state(env.save_state())
            assert_equal(back, undisturbed)
            undisturbed = undisturbed.update(back)
    assert_equal(td, undisturbed)


@pytest.mark.parametrize("robot", sorted(ROBOTS))
def test_saved_state_with_every_robot(env_of: Envs, robot):
    env = env_of(f"robot={robot}", "n_objects=3")
    rollout(env, env.reset_episode(41), 2)
    state = env.save_state()
    first = rollout(env, env.restore_state(state), 2)
    rollout(env, env.reset_episode(42), 1)
    assert_same(first, rollout(env, env.restore_state(state), 2))


def test_config_is_left_alone(env):
    assert env.config == real_config("objects=household", "robot=gripper", "n_objects=3").env


# ------------------------------------------------------------------ other push directions


@pytest.fixture(scope="module")
def sixteen(toys_of: Envs) -> RearrangementEnv:
    return toys_of("gripper", "env.push.directions=16", "n_objects=2")


def test_sixteen_directions_in_the_specs(sixteen):
    check_env_specs(sixteen)
    assert sixteen.action_spec.n == ROWS * 16
    td = lay_out(sixteen, [BOX, BALL], [(-0.15, 0.1), (0.15, 0.1)])
    legal = td["action_mask"].view(ROWS, 16)
    assert legal[:2].all() and not legal[2:].any()
    act(sixteen, td, 0)
    assert sixteen.last_step.legal.shape == (ROWS, 16)


@pytest.mark.parametrize("row", [0, 1])
def test_direction_1_of_16_heads_at_22_5_degrees(sixteen, row):
    places = [(-0.2, 0.25), (0.1, 0.0)]
    # Turned like the push, so that a face of the box meets the tool squarely.
    toys = [BALL, BOX] if row else [BOX, BALL]
    td = lay_out(sixteen, toys, places, yaw=np.radians(22.5))
    act(sixteen, td, row * 16 + 1)
    push = sixteen.last_step.push
    assert (push.row, push.direction, push.result.status) == (row, 1, "done")
    assert np.degrees(push.angle) == pytest.approx(22.5)
    tool = (push.result.end - push.result.start)[:2]
    assert np.degrees(np.arctan2(tool[1], tool[0])) == pytest.approx(22.5)
    moved = (sixteen.last_step.after.poses - sixteen.episode_start.start.poses)[:, :2]
    # Of the push's 6 cm, up to 2 are free.
    assert 0.035 < np.linalg.norm(moved[row]) < 0.06
    assert np.degrees(np.arctan2(*moved[row, ::-1])) == pytest.approx(22.5, abs=8)
    assert np.linalg.norm(moved[1 - row]) < 1e-3


def test_agents_play_with_sixteen_directions(sixteen):
    config = real_config(
        "objects=household", "robot=gripper", "env.push.directions=16", "model=rule_based"
    )
    agent = build_agent(config, np.random.default_rng(0))
    # The goal lies 18 cm away at 22.5 degrees, which is direction 1.
    goal = 0.18 * np.array([np.cos(np.pi / 8), np.sin(np.pi / 8)]) + [0.0, 0.1]
    td = agent(lay_out(sixteen, [BOX], [(0.0, 0.1)], [goal], yaw=np.pi / 8))
    assert td["action"].item() == 1
    sixteen.step(td)
    assert sixteen.last_step.reward_terms["progress"] > 30 * 0.04
    steps = sixteen.rollout(4, policy=agent)
    assert len(steps) >= 1 and steps["action"].max() < ROWS * 16
    assert steps["action_mask"].gather(1, steps["action"][:, None]).all()
