"""A scene with one more field: declared in one place, it is in everything that takes scenes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import torch
from configs import real_config
from small_network import small_network
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs.utils import check_env_specs
from toys import TOYS, toy_env

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.loggers.files import NoLogger
from sdfgcn.task.scene import Scene, scene_field
from sdfgcn.train.hindsight import relabelled
from sdfgcn.train.mirror import mirrored
from sdfgcn.train.replay import Replay
from sdfgcn.train.training import build_trainer

CONFIG = (
    *("objects=household", "robot=gripper", "model=sdfgcn", "n_objects=2", "train.env.split=test"),
    *("env.max_objects=3", "collector=sync", "collector.pushes_per_batch=5", "budget=smoke"),
    *("budget.minutes=null", "train.learning_starts=5", "train.batch_size=16"),
    *("train.replay_capacity=60", "train.checkpoint_minutes=60", "runtime.precision=float32"),
)
SCENES = ("scene", "goal", ("next", "scene"), ("next", "goal"))


class AreaScene(Scene):
    """A scene that also shows how large the masks are; in a mirror, areas are negative."""

    area: Tensor = scene_field(lambda seen: seen.masks.sum(axis=(1, 2)), mirror=torch.neg)


@pytest.fixture(scope="module", autouse=True)
def area_scenes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RearrangementEnv, "scene_type", AreaScene)
        patch.setattr("sdfgcn.sim.world.load_catalogue", lambda config, split: TOYS)
        yield


@pytest.fixture(scope="module")
def env(area_scenes: None) -> Iterator[RearrangementEnv]:
    with closing(toy_env(real_config(*CONFIG).env)) as env:
        yield env


@pytest.fixture(scope="module")
def pushes(env: RearrangementEnv) -> TensorDict:
    """Random pushes of which some move something."""
    torch.manual_seed(0)
    env.set_seed(0)
    return env.rollout(12, break_when_any_done=False)


def areas(scene: Scene) -> Tensor:
    return scene.masks.sum(dim=(-2, -1)).float()


def test_the_env_shows_it(env: RearrangementEnv, pushes: TensorDict) -> None:
    check_env_specs(env)
    assert env.observation_spec["scene", "area"].shape == (3,)
    for key in SCENES:
        assert isinstance(pushes[key], AreaScene)
        assert torch.equal(pushes[key].area, areas(pushes[key]))
        assert (pushes[key].area[:, :2] > 20).all()
        assert not pushes[key].area[:, 2].any()  # no object, no area


def test_it_is_mirrored(env: RearrangementEnv, pushes: TensorDict) -> None:
    image = mirrored(pushes, env.push_space)
    for key in SCENES:
        assert isinstance(image[key], AreaScene)
        assert torch.equal(image[key].area, -pushes[key].area)


def test_hindsight_takes_it_to_the_new_goal(pushes: TensorDict) -> None:
    env = real_config(*CONFIG).env
    offsets = pushes["next", "scene"].position - pushes["scene"].position
    moved = offsets.norm(dim=-1) > 0.005
    made = relabelled(pushes, pushes["next"], 0.005, env)
    assert made is not None
    assert len(made) == int(moved.any(dim=-1).sum()) > 0
    before, moved = pushes[moved.any(dim=-1)], moved[moved.any(dim=-1)]
    wanted = torch.where(moved, before["next", "scene"].area, before["goal"].area)
    assert torch.equal(made["goal"].area, wanted)
    assert not torch.equal(made["goal"].area, before["goal"].area)


def test_it_is_in_what_is_sampled(pushes: TensorDict) -> None:
    replay = Replay(real_config(*CONFIG, "augment.probability=0.5"))
    replay.extend(replay.stored(pushes))
    torch.manual_seed(0)
    batch = replay.sample()
    for key in SCENES:
        assert isinstance(batch[key], AreaScene)
        assert torch.equal(batch[key].area.abs(), areas(batch[key]))
    signs = batch["scene"].area[:, 0].sign()
    assert set(signs.tolist()) == {-1.0, 1.0}  # some are mirrored
    for key in SCENES:
        assert torch.equal(batch[key].area[:, 0].sign(), signs)


def test_a_training_goes_on_with_it(tmp_path: Path) -> None:
    def trained(pushes: int) -> tuple[TensorDict, TensorDict]:
        """The transitions at the start and at the end."""
        config = real_config(*CONFIG, "her=future", f"budget.pushes={pushes}")
        logger = NoLogger(config.logger, tmp_path)
        trainer = build_trainer(config, tmp_path, logger, small_network, lambda *_: None, None)
        buffer = trainer._replay.buffer
        with closing(trainer), torch.random.fork_rng():
            start = buffer.storage.get(slice(0, len(buffer))) if len(buffer) else TensorDict()
            start = start.clone()
            trainer.run()
            return start, buffer.storage.get(slice(0, len(buffer))).clone()

    _, kept = trained(10)
    restored, more = trained(15)
    assert len(restored) >= 10
    assert (restored == kept).all()
    assert len(more) >= len(restored) + 5
    for key in ("scene", "goal", ("next", "scene")):
        assert isinstance(restored[key], AreaScene)
        assert (more[key].area[:, :2] > 0).all()
