"""How the number of objects grows."""

from collections import Counter

import numpy as np
import pytest
import torch
from configs import real_config
from conftest import Envs
from tensordict import TensorDict

from sdfgcn.train.curriculum import Curriculum, ObjectCountSampler


def drawn(counts: ObjectCountSampler, n: int = 2000) -> dict[int, float]:
    rng = np.random.default_rng(0)
    return {count: seen / n for count, seen in Counter(counts.draw(rng) for _ in range(n)).items()}


def test_off_is_always_n_objects() -> None:
    assert drawn(
        ObjectCountSampler(real_config("model=sdfgcn", "curriculum=off").curriculum, 5), n=9
    ) == {5: 1.0}


def test_random_draws_evenly() -> None:
    shares = drawn(
        ObjectCountSampler(real_config("model=sdfgcn", "curriculum=random").curriculum, 3)
    )
    assert shares == pytest.approx({2: 1 / 3, 3: 1 / 3, 4: 1 / 3}, abs=0.05)


def test_on_grows_with_success_at_the_newest_count() -> None:
    config = real_config("model=sdfgcn", "curriculum=on").curriculum
    counts = ObjectCountSampler(config, 3)
    curriculum = Curriculum(config, counts)
    assert drawn(counts) == {2: 1.0}
    for _ in range(99):
        curriculum.episode_ended(2, True)
    assert counts.newest == 2
    curriculum.episode_ended(2, True)
    assert counts.newest == 3
    assert drawn(counts) == pytest.approx({2: 0.5, 3: 0.5}, abs=0.05)
    for _ in range(100):
        curriculum.episode_ended(2, True)  # not the newest
    assert counts.newest == 3
    # Wilson's one-sided 90% bound (z = 1.2816) of 85 in 100 is 0.7986, that of 86 is 0.8097.
    for i in range(100):
        curriculum.episode_ended(3, i >= 15)
    assert counts.newest == 3
    curriculum.episode_ended(3, True)  # the oldest, a failure, leaves the window
    assert counts.newest == 4
    assert drawn(counts) == pytest.approx({2: 0.25, 3: 0.25, 4: 0.5}, abs=0.05)
    for _ in range(120):
        curriculum.episode_ended(4, True)
    assert counts.newest == 4


def test_chance_rarely_opens_the_next_count() -> None:
    """At a true rate of 75%, in 20 trainings of 400 episodes; a mean of 50 opens it in most."""
    rng = np.random.default_rng(0)
    opened = Counter()
    for overrides in ((), ("curriculum.confidence=0.5", "curriculum.window=50")):
        config = real_config("model=sdfgcn", "curriculum=on", *overrides).curriculum
        for _ in range(20):
            counts = ObjectCountSampler(config, 3)
            curriculum = Curriculum(config, counts)
            for success in rng.random(400) < 0.75:
                curriculum.episode_ended(2, bool(success))
            opened[overrides] += counts.newest > 2
    assert opened[()] <= 4
    assert opened["curriculum.confidence=0.5", "curriculum.window=50"] >= 10


def test_an_episode_counts_by_the_objects_on_the_table(toys_of: Envs) -> None:
    """The env tells how many there are, also where neither they nor their goals are detected."""
    env = toys_of("gripper", "n_objects=2", "env.perception.min_pixels=9000")
    begun = env.reset_episode(0)
    assert not begun["goal"].node_mask.any()
    pushed = env.step(begun.set("action", torch.tensor(0)))
    assert bool(pushed["next", "done"])
    config = real_config("model=sdfgcn", "curriculum=on").curriculum
    curriculum = Curriculum(config, ObjectCountSampler(config, 3))
    curriculum.pushed(pushed[None])
    assert curriculum.state_dict() == {"reached": 1, "recent": [0]}  # 2 is the newest


def test_only_ends_of_episodes_count() -> None:
    overrides = ("curriculum=on", "curriculum.window=2", "curriculum.confidence=0.5")
    config = real_config("model=sdfgcn", *overrides).curriculum
    counts = ObjectCountSampler(config, 3)
    curriculum = Curriculum(config, counts)
    outcome = {
        "done": torch.tensor([[False], [True], [True], [True]]),
        "success": torch.ones(4, 1, dtype=torch.bool),
        "n_objects": torch.tensor([[2], [2], [3], [2]]),  # 3 is not the newest yet
    }
    pushes = TensorDict({"next": outcome}, batch_size=[4])
    curriculum.pushed(pushes[:3])
    assert counts.newest == 2
    curriculum.pushed(pushes[3:])
    assert counts.newest == 3


def test_goes_on_from_its_state() -> None:
    config = real_config("model=sdfgcn", "curriculum=on").curriculum
    before, after = (ObjectCountSampler(config, 3) for _ in range(2))
    first, second = Curriculum(config, before), Curriculum(config, after)
    for _ in range(199):
        first.episode_ended(before.newest, True)
    second.load_state_dict(first.state_dict())
    assert after.newest == before.newest == 3
    second.episode_ended(3, True)
    assert after.newest == 4


def test_counts_are_shared_between_processes() -> None:
    assert ObjectCountSampler(
        real_config("model=sdfgcn", "curriculum=on").curriculum, 3
    ).reached.is_shared()
