"""Hindsight: transitions with other goals, worked out by hand."""

import pytest
import torch
from configs import real_config
from tensordict import TensorDict

from sdfgcn.config import HerConfig
from sdfgcn.train.hindsight import Hindsight, relabelled

ENV = real_config().env
MOVED = 0.005
START = torch.tensor([[0.0, 0.0], [0.2, 0.0], [0.0, 0.0]])  # the third slot is empty
GOAL = torch.tensor([[0.0, 0.2], [0.2, 0.03], [0.0, 0.0]])


def push(after: torch.Tensor, found: list[bool] | None = None, **outcome: bool) -> TensorDict:
    """One push of two objects from START to `after`; pictures hold a number for each node."""
    nodes = torch.tensor([True, True, False])
    left = nodes if found is None else torch.tensor(found)
    scene, next_scene, goal = (
        (value + torch.arange(3.0)[:, None, None]).expand(3, 4, 4) for value in (10, 20, 30)
    )
    flags = {"success": False, "out_of_range": False, "terminated": False, "truncated": False}
    flags |= outcome
    return TensorDict(
        {
            "sdf": scene.clone(),
            "node_mask": nodes,
            "center": START + 0.001,
            "position": START,
            "correspondence": torch.tensor([0, 1, -1]),
            "goal_sdf": goal.clone(),
            "goal_node_mask": nodes,
            "goal_center": GOAL + 0.001,
            "goal_position": GOAL,
            "action": torch.tensor(3),
            "collector": {"traj_ids": torch.tensor(0)},
            "next": {
                "sdf": next_scene.clone(),
                "node_mask": left,
                "center": after + 0.001,
                "position": after,
                "correspondence": torch.where(left, torch.tensor([0, 1, -1]), -1),
                "reward": torch.zeros(1),
                **{key: torch.tensor([value]) for key, value in flags.items()},
                "done": torch.tensor([flags["terminated"] or flags["truncated"]]),
            },
        }
    )


def moved(*offsets: tuple[float, float]) -> torch.Tensor:
    after = START.clone()
    after[: len(offsets)] += torch.tensor(offsets)
    return after


def only(pushes: TensorDict) -> TensorDict:
    result = relabelled(pushes[None], pushes[None]["next"], MOVED, ENV)
    assert result is not None
    assert len(result) == 1
    return result[0]


def test_the_moved_objects_goal_is_where_it_ended() -> None:
    before = push(moved((0.06, 0.0)))
    kept = before.clone()
    after = only(before)
    assert (before == kept).all()
    wanted = torch.tensor([[0.06, 0.0], [0.2, 0.03], [0.0, 0.0]])
    torch.testing.assert_close(after["goal_position"], wanted)
    assert after["goal_sdf"][:, 0, 0].tolist() == [20.0, 31.0, 32.0]
    torch.testing.assert_close(after["goal_center"][0], torch.tensor([0.061, 0.001]))
    assert after["action"] == 3


def test_reward_and_end_follow() -> None:
    # 60 mm nearer to the new goal, at it, and the other object within the threshold: 50 mm.
    after = only(push(moved((0.06, 0.0))))["next"]
    assert float(after["reward"]) == pytest.approx(30 * 0.06 - 0.02 + 10.0, abs=1e-5)
    assert (bool(after["success"]), bool(after["terminated"]), bool(after["done"])) == (True,) * 3


def test_an_object_far_from_its_goal_prevents_success() -> None:
    # The second moved by 60 mm; the first stays 200 mm from its own goal.
    after = only(push(moved((0.0, 0.0), (0.0, -0.06)), truncated=True))["next"]
    assert float(after["reward"]) == pytest.approx(30 * 0.06 - 0.02, abs=1e-5)
    assert (bool(after["terminated"]), bool(after["truncated"]), bool(after["done"])) == (
        *(False, True, True),
    )


def test_success_overrules_the_step_limit() -> None:
    after = only(push(moved((0.06, 0.0)), truncated=True))["next"]
    assert (bool(after["terminated"]), bool(after["truncated"])) == (True, False)


def test_out_of_range_stays_so() -> None:
    after = only(push(moved((0.0, 0.0), (0.06, 0.0)), out_of_range=True, terminated=True))["next"]
    assert float(after["reward"]) == pytest.approx(30 * 0.06 - 0.02 - 2.0, abs=1e-5)
    assert bool(after["terminated"])


def test_a_push_that_moved_nothing_is_left_out() -> None:
    still = push(moved((0.004, 0.0)))[None]
    assert relabelled(still, still["next"], MOVED, ENV) is None


@pytest.mark.parametrize("offsets", [[(0.06, 0.0)], [(0.0, 0.0), (0.0, 0.06)]])
def test_where_an_object_vanished_no_reward_can_be_told(offsets: list[tuple[float, float]]) -> None:
    gone = push(moved(*offsets), found=[False, True, False])[None]
    assert relabelled(gone, gone["next"], MOVED, ENV) is None


def test_objects_that_are_not_matched_by_slot() -> None:
    pushed = push(moved((0.06, 0.0)))
    pushed["correspondence"] = torch.tensor([1, 0, -1])  # node 0 belongs to goal node 1
    after = only(pushed)
    assert after["goal_sdf"][:, 0, 0].tolist() == [30.0, 20.0, 32.0]


def test_off_makes_nothing() -> None:
    assert Hindsight(HerConfig(name="off"), ENV)(push(moved((0.06, 0.0)))[None]) is None


def test_next_is_the_push_itself() -> None:
    hindsight = Hindsight(HerConfig(name="next", min_displacement=MOVED), ENV)
    two = torch.stack([push(moved((0.06, 0.0))), push(moved((0.0, 0.0)))])
    made = hindsight(two)
    assert made is not None
    assert len(made) == 1


def test_future_waits_for_the_episodes_end() -> None:
    torch.manual_seed(0)
    hindsight = Hindsight(HerConfig(name="future", min_displacement=MOVED, per_push=20), ENV)
    first = push(moved((0.06, 0.0)))
    last = push(moved((0.0, 0.1)), terminated=True)
    assert hindsight(first[None]) is None
    made = hindsight(last[None])
    assert made is not None
    goals = {tuple(round(x, 3) for x in goal) for goal in made["goal_position"][:, 0].tolist()}
    assert goals == {(0.06, 0.0), (0.0, 0.1)}
    of_last = made["next", "position"][:, 0, 1] > 0.09
    assert (made["goal_position"][of_last][:, 0, 1] > 0.09).all()  # never an earlier push
    assert hindsight(first[None]) is None  # the episode is forgotten
