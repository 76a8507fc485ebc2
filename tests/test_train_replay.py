"""The replay buffer: masks in, SDFs out; and the mirror symmetry of the table."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from configs import real_config
from conftest import Envs
from tensordict import TensorDict

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.task.push_space import PushSpace
from sdfgcn.task.scene import Scene
from sdfgcn.train.mirror import MirrorTransform, mirrored
from sdfgcn.train.replay import Replay
from sdfgcn.train.state_file import TENSORS, StateFileAdapter

SIZE = 96
PUSHES = PushSpace(real_config().env.push, real_config().env.arena)
SMALL = ("env.max_objects=4", "train.batch_size=16", "train.replay_capacity=64")


def collect(env: RearrangementEnv, pushes: int) -> TensorDict:
    torch.manual_seed(0)
    env.set_seed(0)
    return env.rollout(pushes, break_when_any_done=False)


@pytest.fixture(scope="module")
def collected(env_of: Envs) -> TensorDict:
    return collect(env_of("robot=gripper", "env.max_objects=4"), 12)


# ------------------------------------------------------------------ packing


def replay_of(collected: TensorDict, *overrides: str) -> Replay:
    replay = Replay(real_config(*SMALL, *overrides))
    replay.extend(replay.stored(collected))
    return replay


def scenes(pushes: TensorDict) -> list[Scene]:
    return [pushes[key] for key in ("scene", "goal", ("next", "scene"), ("next", "goal"))]


def test_what_goes_in_comes_out(collected: TensorDict) -> None:
    given = replay_of(collected, "augment=off").buffer[:]
    for key in ("matched", "action_mask", "action", ("next", "reward"), ("next", "matched")):
        assert torch.equal(given[key], collected[key])
    for out, into in zip(scenes(given), scenes(collected), strict=True):
        assert isinstance(out, Scene)
        for name in ("node_mask", "center", "position"):
            assert torch.equal(out.get(name), into.get(name))
        torch.testing.assert_close(out.sdf, into.sdf, atol=0.07, rtol=0)
        assert torch.equal(out.masks, into.masks)
    assert not any("pixels" in str(key) for key in given.keys(True))


def test_a_transition_is_small(collected: TensorDict) -> None:
    replay = replay_of(collected)
    stored = replay.buffer.storage.get(range(len(collected)))
    size = sum(value.nbytes for value in stored.values(True, True)) / len(collected)
    assert size < 4 * 3 * (96 * 96 // 8) + 1000  # bytes: three masks a slot, and small keys


def test_sampling_is_repeatable(collected: TensorDict) -> None:
    batches = []
    for _ in range(2):
        replay = replay_of(collected, "augment=mirror")
        torch.manual_seed(3)
        batches.append(replay.sample())
    assert (batches[0] == batches[1]).all()
    assert batches[0].batch_size == torch.Size([16])


def test_storing_and_sampling_leave_pushes_as_they_were(collected: TensorDict) -> None:
    kept = collected.clone()
    replay = replay_of(collected, "augment=mirror")
    there = replay.buffer.storage.get(range(len(collected))).clone()
    replay.sample()
    assert (collected == kept).all()
    assert (replay.buffer.storage.get(range(len(collected))) == there).all()


def test_a_saved_buffer_is_the_same_and_can_be_filled_on(collected: TensorDict, tmp_path) -> None:
    first = replay_of(collected, "augment=off")
    StateFileAdapter().save(first, tmp_path / "replay", args=(), kwargs={})
    second = Replay(real_config(*SMALL, "augment=off"))
    options = {"map_location": None, "tensor_load_kwargs": {}, "args": (), "kwargs": {}}
    StateFileAdapter().load(second, tmp_path / "replay", **options)
    file = tmp_path / "replay" / TENSORS
    file.write_bytes(b"\xff" * file.stat().st_size)  # nothing may still depend on it
    assert len(second) == len(first) == len(collected)
    for _ in range(7):  # past the capacity of 64
        assert (second.buffer[:] == first.buffer[:]).all()
        assert all(isinstance(scene, Scene) for scene in scenes(second.buffer[:]))
        for replay in (first, second):
            replay.extend(replay.stored(collected.flip(0)))
    assert len(second) == 64


def test_the_field_that_is_used_least_is_forgotten() -> None:
    masks = np.stack([np.roll(np.eye(8, dtype=bool), shift, axis=1) for shift in range(3)])
    sdf = SdfTransform("edt", 8, kept=2)
    marked = torch.from_numpy(np.where(masks[:1], -7.0, 7.0))
    sdf.pack(marked, torch.tensor([True]))
    sdf.fields(masks[1:2])
    sdf.fields(masks[:1])
    sdf.fields(masks[2:])  # in place of the second
    assert len(sdf) == 2
    np.testing.assert_array_equal(sdf.fields(masks[:1]), marked)
    exact = SdfTransform("edt", 8).fields(masks[1:2])
    np.testing.assert_allclose(sdf.fields(masks[1:2]), exact, atol=1e-2)
    sdf.fields(masks[2:])
    np.testing.assert_allclose(sdf.fields(masks[:1]), SdfTransform("edt", 8).fields(masks[:1]))


# ------------------------------------------------------------------ mirror


@pytest.mark.parametrize("n", [4, 8, 16])
def test_directions_are_mirrored(n: int) -> None:
    config = real_config().env
    pushes = PushSpace(replace(config.push, directions=n), config.arena)
    actions = torch.arange(2 * n)  # of two rows
    for action, there in zip(
        actions.tolist(), pushes.mirrored_action(actions).tolist(), strict=True
    ):
        (row, k), (row_there, k_there) = pushes.decode(action), pushes.decode(there)
        assert row == row_there
        here, other = (np.exp(1j * pushes.angles[each]) for each in (k, k_there))
        assert other == pytest.approx(-here.conjugate(), abs=1e-12)
        mask = torch.zeros(2 * n).index_fill(0, torch.tensor([action]), 1.0)
        assert pushes.mirrored(mask).argmax() == there


def test_mirrored_twice_is_the_same(collected: TensorDict) -> None:
    once = mirrored(collected, PUSHES)
    assert (mirrored(once, PUSHES) == collected).all()
    for part in (once, once["next"]):
        assert isinstance(part["scene"], Scene)
        assert isinstance(part["goal"], Scene)
    for key in ("action_mask", "action", ("scene", "sdf"), ("next", "goal", "center")):
        assert not torch.equal(once[key], collected[key])


def test_a_share_of_what_is_sampled_is_mirrored(collected: TensorDict) -> None:
    many = torch.cat([collected] * 20)
    torch.manual_seed(0)
    kept = many.clone()
    given = MirrorTransform(0.25, PUSHES)(many)
    assert (many == kept).all()
    other = (given["scene"].center != many["scene"].center).flatten(1).any(dim=1)
    assert float(other.float().mean()) == pytest.approx(0.25, abs=0.08)
    assert (given[~other] == many[~other]).all()
    assert (given[other] == mirrored(many[other], PUSHES)).all()
    assert isinstance(given["goal"], Scene)


@cache
def transform(method: str) -> SdfTransform:
    return SdfTransform(method, SIZE)


def edt(scene: Scene, found: torch.Tensor) -> np.ndarray:
    """The exact distances in a picture, mirrored."""
    return transform("edt").fields(scene.masks[found].numpy())[..., ::-1]


def test_a_mirrored_picture_offers_the_mirrored_pushes(collected: TensorDict) -> None:
    """What the env would see and plan in the mirrored scene is the mirrored observation."""
    for observation in collected[:8]:
        found = observation["scene"].node_mask
        image = mirrored(observation, PUSHES)
        masks, sdf = image["scene"].masks[found].numpy(), image["scene"].sdf[found].numpy()
        np.testing.assert_array_equal(
            transform("edt").fields(masks), edt(observation["scene"], found)
        )
        # Fast marching takes ties in the order of the pixels.
        apart = np.abs(transform("fmm").fields(masks) - sdf)
        assert apart.max() < 0.3 and (apart > 0.1).mean() < 0.001
        plan = PUSHES.plan(masks, sdf)
        np.testing.assert_allclose(plan.center, image["scene"].center[found], atol=1e-6)
        legal = PUSHES.by_direction(image["action_mask"])[found].numpy()
        assert (plan.legal == legal).all()


def test_a_mirrored_scene_gives_the_mirrored_picture(toys_of: Envs) -> None:
    """The real renderer, with bodies that are their own mirror images."""
    env = toys_of("gripper")
    env.reset_episode(0)
    state = env.save_state()
    poses = np.array(state["world"]["poses"])
    here = env.restore_state(state)
    reflected = poses * np.array([-1, 1, 1, 1, 1, -1, -1])  # the yaw of a mirrored body is -yaw
    there = env.restore_state({**state, "world": {**state["world"], "poses": reflected.tolist()}})
    image, scene = mirrored(here, PUSHES)["scene"], there["scene"]
    differing = (image.masks != scene.masks).sum(dim=(1, 2))
    assert (differing <= 4).all()  # pixels on the very edge
    torch.testing.assert_close(image.center, scene.center, atol=2e-3, rtol=0)
    torch.testing.assert_close(image.position, scene.position, atol=1e-6, rtol=0)
    assert torch.equal(image.node_mask, scene.node_mask)
