"""The replay buffer: masks in, SDFs out; and the mirror symmetry of the table."""

import numpy as np
import pytest
import torch
from configs import real_config
from conftest import Envs
from sdfgcn.perception.push_start import PushPlanner
from tensordict import TensorDict

from sdfgcn.config import N_DIRECTIONS
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.perception.sdf import SdfCache, signed_distance, signed_distances
from sdfgcn.sim.push import direction_vector
from sdfgcn.train.mirror import MIRRORED_DIRECTION, mirrored
from sdfgcn.train.replay import build_replay, transitions

SMALL = ("env.max_objects=4", "train.batch_size=16", "train.replay_capacity=64")


def collect(env: RearrangementEnv, pushes: int) -> TensorDict:
    torch.manual_seed(0)
    env.set_seed(0)
    return env.rollout(pushes, break_when_any_done=False)


@pytest.fixture(scope="module")
def collected(env_of: Envs) -> TensorDict:
    return collect(env_of("robot=gripper", "env.max_objects=4"), 12)


# ------------------------------------------------------------------ packing


def test_what_goes_in_comes_out(collected: TensorDict) -> None:
    replay = build_replay(real_config(*SMALL, "augment=off"))
    kept = transitions(collected)
    replay.extend(kept)
    given = replay[:]
    for key in ("node_mask", "correspondence", "action", ("next", "reward"), ("next", "center")):
        assert torch.equal(given[key], collected[key])
    for key in ("sdf", "goal_sdf", ("next", "sdf"), ("next", "goal_sdf")):
        torch.testing.assert_close(given[key], collected[key], atol=0.07, rtol=0)
        assert torch.equal(given[key] < 0, collected[key] < 0)
    assert not any("pixels" in str(key) for key in given.keys(True))


def test_a_transition_is_small(collected: TensorDict) -> None:
    replay = build_replay(real_config(*SMALL))
    replay.extend(transitions(collected))
    stored = replay.storage.get(range(len(collected)))
    size = sum(value.nbytes for value in stored.values(True, True)) / len(collected)
    assert size < 4 * 3 * (96 * 96 // 8) + 1000  # bytes: three masks a slot, and small keys


def test_sampling_is_repeatable(collected: TensorDict) -> None:
    batches = []
    for _ in range(2):
        replay = build_replay(real_config(*SMALL, "augment=mirror"))
        replay.extend(transitions(collected))
        torch.manual_seed(3)
        batches.append(replay.sample())
    assert (batches[0] == batches[1]).all()
    assert batches[0].batch_size == torch.Size([16])


def test_the_cache_forgets_what_is_used_least() -> None:
    masks = [np.roll(np.eye(8, dtype=bool), shift, axis=1) for shift in range(3)]
    packed = [np.packbits(mask).tobytes() for mask in masks]
    cache = SdfCache(2, (8, 8), "edt")
    marked = np.full((8, 8), 7.0, dtype=np.float32)
    cache.put(packed[0], marked)
    cache.get(packed[1])
    cache.get(packed[0])
    cache.get(packed[2])  # in place of the second
    assert len(cache) == 2
    assert (cache.get(packed[0]) == 7.0).all()
    np.testing.assert_allclose(cache.get(packed[1]), signed_distance(masks[1], "edt"), atol=1e-2)


# ------------------------------------------------------------------ mirror


def test_directions_are_mirrored() -> None:
    for k in range(N_DIRECTIONS):
        there = direction_vector(int(MIRRORED_DIRECTION[k]))
        np.testing.assert_allclose(there, direction_vector(k) * [-1, 1], atol=1e-12)


def test_mirrored_twice_is_the_same(collected: TensorDict) -> None:
    kept = transitions(collected)
    twice = mirrored(mirrored(kept))
    assert (twice == kept).all()
    assert not torch.equal(mirrored(kept)["action_mask"], kept["action_mask"])


def edt(observation: TensorDict, found: torch.Tensor) -> np.ndarray:
    """The exact distances in a picture, mirrored."""
    masks = (observation["sdf"][found] < 0).numpy()
    return signed_distances(masks, "edt")[..., ::-1]


def test_a_mirrored_picture_offers_the_mirrored_pushes(env_of: Envs, collected: TensorDict) -> None:
    """What the env would see and plan in the mirrored scene is the mirrored observation."""
    env = env_of("robot=gripper", "env.max_objects=4")
    for observation in collected[:8]:
        found = observation["node_mask"]
        image = mirrored(observation)
        masks = (image["sdf"][found] < 0).numpy()
        sdf = image["sdf"][found].numpy()
        np.testing.assert_array_equal(signed_distances(masks, "edt"), edt(observation, found))
        # Fast marching takes ties in the order of the pixels.
        apart = np.abs(signed_distances(masks, "fmm") - sdf)
        assert apart.max() < 0.3 and (apart > 0.1).mean() < 0.001
        planner = PushPlanner(env.camera, env.config.push, env.config.arena)
        plan = planner.plan(masks, sdf)
        np.testing.assert_allclose(plan.center, image["center"][found], atol=1e-6)
        legal = image["action_mask"].reshape(-1, N_DIRECTIONS)[found].numpy()
        assert (plan.legal == legal).all()


def test_a_mirrored_scene_gives_the_mirrored_picture(toys_of: Envs) -> None:
    """The real renderer, with bodies that are their own mirror images."""
    env = toys_of("gripper")
    env.reset_episode(0)
    state = env.save_state()
    poses = state["poses"]
    here = env.restore_state(state)
    reflected = poses * np.array([-1, 1, 1, 1, 1, -1, -1])  # the yaw of a mirrored body is -yaw
    there = env.restore_state({**state, "poses": reflected})
    image = mirrored(here)
    differing = ((image["sdf"] < 0) != (there["sdf"] < 0)).sum(dim=(1, 2))
    assert (differing <= 4).all()  # pixels on the very edge
    torch.testing.assert_close(image["center"], there["center"], atol=2e-3, rtol=0)
    torch.testing.assert_close(image["position"], there["position"], atol=1e-6, rtol=0)
    assert torch.equal(image["node_mask"], there["node_mask"])
