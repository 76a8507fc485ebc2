"""What TorchRL, and anyone who trains or evaluates with it, may rely on."""

import pickle

import numpy as np
import pytest
import torch
from configs import real_config
from conftest import Envs
from tensordict import TensorDictBase
from torchrl.envs.utils import check_env_specs
from toys import BALL, BOX, act, lay_out

from sdfgcn.config import N_DIRECTIONS
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.registry import ROBOTS

SIZE = 96
SLOTS = 8


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
    poses = env.last_step.scene.poses if env.last_step else env.episode_start.scene.poses
    return {key: td[key].clone() for key in td.keys()} | {"poses": torch.from_numpy(poses)}  # noqa: SIM118


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
        assert td["sdf"].shape == td["goal_sdf"].shape == (SLOTS, SIZE, SIZE)
        assert ("pixels" in td) is ("goal_pixels" in td) is pixels
        if pixels:
            assert td["pixels"].shape == (SIZE, SIZE, 3) and td["pixels"].dtype == torch.uint8
            # The goal is another picture, of the same table.
            assert (td["pixels"] != td["goal_pixels"]).any()
            assert td["pixels"].float().std() > 10
        td = act(env, td, int(env.rand_action(td.clone())["action"]))
    assert env.action_spec.n == SLOTS * N_DIRECTIONS


def test_pixels_are_only_rendered_on_demand(env):
    env.reset_episode(0)
    assert env.episode_start.scene.pixels is None and env.episode_start.goal.pixels is None
    env.record = True
    try:
        td = env.reset_episode(0)
        act(env, td, 63)
    finally:
        env.record = False
    for scene in (env.episode_start.scene, env.episode_start.goal, env.last_step.scene):
        assert scene.pixels.shape == (SIZE, SIZE, 3)
    # An object has another colour than the table around it.
    (mask, *_), pixels = env.episode_start.scene.masks, env.episode_start.scene.pixels
    table = ~env.episode_start.scene.masks.any(axis=0)
    assert np.abs(pixels[mask].mean(axis=0) - pixels[table].mean(axis=0)).max() > 20


def test_rows_without_an_object_are_zero(env):
    td = env.reset_episode(1)
    for _ in range(2):
        assert td["node_mask"].tolist() == [True] * 3 + [False] * 5
        assert td["goal_node_mask"].tolist() == [True] * 3 + [False] * 5
        for key in ("sdf", "goal_sdf", "position", "goal_position"):
            assert (td[key][3:] == 0).all(), key
            assert (td[key][:3].flatten(1) != 0).any(1).all(), key
        assert not td["action_mask"].view(SLOTS, N_DIRECTIONS)[3:].any()
        td = act(env, td, int(torch.nonzero(td["action_mask"])[0]))


def test_observation_tells_what_the_scene_holds(env):
    td = env.reset_episode(2)
    start = env.episode_start
    np.testing.assert_allclose(td["position"][:3], start.scene.poses[:, :2], atol=1e-6)
    np.testing.assert_allclose(td["goal_position"][:3], start.goal.poses[:, :2], atol=1e-6)
    assert not torch.equal(td["sdf"], td["goal_sdf"])
    # Negative just where the mask is.
    np.testing.assert_array_equal(td["sdf"][:3].numpy() < 0, start.scene.masks)
    np.testing.assert_array_equal(td["goal_sdf"][:3].numpy() < 0, start.goal.masks)
    assert td["pushes"].item() == 0 and not td["success"].item()
    assert start.seed == 2 and len(start.objects) == 3


# ------------------------------------------------------------------ actions


def test_action_index_is_object_times_8_plus_direction(env):
    for slot, direction in ((0, 1), (1, 6), (2, 3)):
        # An episode where this push is legal and nothing else is in its way.
        for seed in range(20):
            td = env.reset_episode(seed)
            action = slot * N_DIRECTIONS + direction
            others = np.delete(env.episode_start.scene.poses[:, :2], slot, axis=0)
            apart = np.linalg.norm(others - env.episode_start.scene.poses[slot, :2], axis=1).min()
            if td["action_mask"][action] and apart > 0.2:
                break
        before = env.episode_start.scene.poses
        act(env, td, action)
        record = env.last_step
        assert (record.push.object, record.push.direction) == (slot, direction)
        assert record.push.status == "done" and record.index == 1
        moved = (record.scene.poses - before)[:, :2]
        lengths = np.linalg.norm(moved, axis=1)
        assert lengths[slot] > 0.03 and np.delete(lengths, slot).max() < 1e-3
        angle = np.degrees(np.arctan2(moved[slot, 1], moved[slot, 0]))
        assert abs((angle - 45 * direction + 180) % 360 - 180) < 25


def test_illegal_actions_move_nothing_and_cost_a_step(env):
    td = env.reset_episode(3)
    before = env.episode_start.scene
    # The last slot, and the first one without an object.
    for i, action in enumerate((SLOTS * N_DIRECTIONS - 1, 3 * N_DIRECTIONS), start=1):
        td = act(env, td, action)
        assert env.last_step.push.status == "unreachable"
        np.testing.assert_array_equal(env.last_step.scene.poses, before.poses)
        np.testing.assert_array_equal(env.last_step.scene.masks, before.masks)
        assert td["reward"].item() == pytest.approx(-0.02)
        assert td["pushes"].item() == i and not td["done"].item()


def test_push_without_a_start_moves_nothing(toys_of: Envs):
    """3 cm of box and 1.9 cm of clearance behind x = -0.305 is beyond the tool's -0.35."""
    toys = toys_of("gripper")
    td = lay_out(toys, [BOX, BALL], [(-0.305, 0.1), (0.1, 0.1)])
    legal = td["action_mask"].view(SLOTS, N_DIRECTIONS)
    assert not legal[0, [0, 1, 7]].any() and legal[0, 2:7].all() and legal[1].all()
    before = toys._task.poses(toys._environment.physics)
    for direction in (0, 1, 7):
        td = act(toys, td, direction)
        assert toys.last_step.push.status == "unreachable"
        assert toys.last_step.push.object == 0
        np.testing.assert_array_equal(toys.last_step.scene.poses, before)


def test_samples_are_legal(env):
    for seed in range(10):
        td = env.reset_episode(seed)
        assert 0 < td["action_mask"].sum() <= 3 * N_DIRECTIONS
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
    assert not torch.equal(env.reset_episode(12)["sdf"], first[0]["sdf"])


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
    following = env.reset()["sdf"]
    # Later, in the same environment, after another episode.
    rollout(env, env.reset_episode(4), 3)
    back = env.restore_state(state)
    assert back["pushes"].item() == 3
    for key in back.keys():  # noqa: SIM118
        assert torch.equal(back[key], td[key]), key
    assert_same(original, rollout(env, back, 5)[1:])
    # On disk and back, into a new environment; the episodes after it are the same too.
    other = RearrangementEnv(env.config, seed=77)
    try:
        restored = other.restore_state(pickle.loads(pickle.dumps(state)))
        assert_same(original, rollout(other, restored, 5)[1:])
        assert torch.equal(other.reset()["sdf"], following)
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
            for key in back.keys():  # noqa: SIM118
                assert torch.equal(back[key], undisturbed[key]), key
            undisturbed = undisturbed.update(back)
    for key in td.keys():  # noqa: SIM118
        assert torch.equal(td[key], undisturbed[key]), key


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
