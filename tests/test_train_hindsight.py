"""Hindsight: transitions with other goals, worked out by hand."""

import pytest
import torch
from configs import real_config
from tensordict import TensorDict, TensorDictBase

from sdfgcn.config import HerConfig
from sdfgcn.task.scene import Scene
from sdfgcn.train.hindsight import Hindsight, relabelled

ENV = real_config().env
MOVED = 0.005
START = torch.tensor([[0.0, 0.0], [0.2, 0.0], [0.0, 0.0]])  # the third row is empty
GOAL = torch.tensor([[0.0, 0.2], [0.2, 0.03], [0.0, 0.0]])
BOTH = (True, True, False)
EPISODE = torch.tensor([0])


def scene(picture: float, position: torch.Tensor, nodes: tuple[bool, ...]) -> Scene:
    """A scene whose pictures hold a number for each row; rows without an object are zero."""
    found = torch.tensor(nodes)
    rows = (picture + torch.arange(3.0))[:, None, None].expand(3, 4, 4)
    return Scene(
        sdf=rows * found[:, None, None],
        node_mask=found,
        center=(position + 0.001) * found[:, None],
        position=position * found[:, None],
        batch_size=[],
    )


def push(
    after: torch.Tensor,
    *,
    start: torch.Tensor = START,
    before: tuple[bool, ...] = BOTH,
    found: tuple[bool, ...] | None = None,
    goal: tuple[bool, ...] = BOTH,
    matched: tuple[bool, ...] = BOTH,
    matched_after: tuple[bool, ...] | None = None,
    **outcome: bool,
) -> TensorDict:
    """One push from `start` to `after`; which rows hold an object before, after and in the goal."""
    left = before if found is None else found
    pairs = torch.tensor(matched)
    pairs_after = pairs & torch.tensor(left)
    flags = {"success": False, "out_of_range": False, "terminated": False, "truncated": False}
    flags |= outcome
    return TensorDict(
        {
            "scene": scene(10, start, before),
            "goal": scene(30, GOAL, goal),
            "matched": pairs,
            "action": torch.tensor(3),
            "next": {
                "scene": scene(20, after, left),
                "matched": pairs_after if matched_after is None else torch.tensor(matched_after),
                "reward": torch.zeros(1),
                **{key: torch.tensor([value]) for key, value in flags.items()},
                "done": torch.tensor([flags["terminated"] or flags["truncated"]]),
            },
        }
    )


def moved(*offsets: tuple[float, float], start: torch.Tensor = START) -> torch.Tensor:
    after = start.clone()
    after[: len(offsets)] += torch.tensor(offsets)
    return after


def relabelled_alone(pushed: TensorDict) -> TensorDictBase | None:
    return relabelled(pushed[None], pushed[None]["next"], MOVED, ENV)


def only(pushed: TensorDict) -> TensorDictBase:
    result = relabelled_alone(pushed)
    assert result is not None
    assert len(result) == 1
    return result[0]


def test_the_moved_objects_goal_is_where_it_ended() -> None:
    before = push(moved((0.06, 0.0)))
    kept = before.clone()
    after = only(before)
    assert (before == kept).all()
    wanted = torch.tensor([[0.06, 0.0], [0.2, 0.03], [0.0, 0.0]])
    torch.testing.assert_close(after["goal"].position, wanted)
    assert after["goal"].sdf[:, 0, 0].tolist() == [20.0, 31.0, 0.0]
    torch.testing.assert_close(after["goal"].center[0], torch.tensor([0.061, 0.001]))
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
    assert relabelled_alone(push(moved((0.004, 0.0)))) is None


@pytest.mark.parametrize("offsets", [[(0.06, 0.0)], [(0.0, 0.0), (0.0, 0.06)]])
def test_where_an_object_vanished_no_reward_can_be_told(offsets: list[tuple[float, float]]) -> None:
    assert relabelled_alone(push(moved(*offsets), found=(False, True, False))) is None


# ------------------------------------------------------------------ rows that are not matched


def test_an_object_without_a_goal_earns_nothing_and_prevents_nothing() -> None:
    """The goal of row 0 is empty, so all zero: the object that moves to (0, 0) is not at it."""
    start = torch.tensor([[0.0, 0.06], [0.2, 0.0], [0.0, 0.0]])
    pushed = push(
        moved((0.0, -0.06), (0.06, 0.0), start=start),
        start=start,
        goal=(False, True, False),
        matched=(False, True, False),
    )
    after = only(pushed)
    assert after["goal"].node_mask.tolist() == [False, True, False]
    assert after["goal"].sdf[:, 0, 0].tolist() == [0.0, 21.0, 0.0]
    torch.testing.assert_close(after["goal"].position[1], torch.tensor([0.26, 0.0]))
    assert float(after["next", "reward"]) == pytest.approx(30 * 0.06 - 0.02 + 10.0, abs=1e-5)
    assert bool(after["next", "success"])


def test_a_goal_without_its_object_is_not_reached() -> None:
    """Row 1 of scene and goal lie at the same place, but show different objects."""
    pushed = push(moved((0.06, 0.0), (0.0, 0.03)), matched=(True, False, False))
    after = only(pushed)
    assert after["goal"].sdf[:, 0, 0].tolist() == [20.0, 31.0, 0.0]
    assert not bool(after["next", "success"])
    assert not bool(after["next", "done"])
    assert float(after["next", "reward"]) == pytest.approx(30 * 0.06 - 0.02, abs=1e-5)


def test_an_empty_row_of_the_scene_is_not_at_its_goal() -> None:
    """The goal of the empty row 0, whose position is zero, lies at (0, 0) but for 30 mm."""
    pushed = push(
        moved((0.0, 0.0), (0.06, 0.0)), before=(False, True, False), matched=(False, True, False)
    )
    near = pushed["goal"].position.clone()
    near[0] = torch.tensor([0.03, 0.0])
    pushed["goal"] = pushed["goal"].replace(position=near)
    after = only(pushed)
    assert not bool(after["next", "success"])
    assert float(after["next", "reward"]) == pytest.approx(30 * 0.06 - 0.02, abs=1e-5)


def test_only_what_is_matched_gets_another_goal() -> None:
    assert relabelled_alone(push(moved((0.06, 0.0)), matched=(False, True, False))) is None


@pytest.mark.parametrize("lost_at", ["next", "later"])
def test_a_row_that_is_lost_may_show_another_object(lost_at: str) -> None:
    """What fills the row of an object that is not recognised any more is not that object."""
    lost = (False, True, False)
    pushed = push(moved((0.06, 0.0)), matched_after=lost if lost_at == "next" else None)
    later = push(moved((0.06, 0.0)), matched_after=lost if lost_at == "later" else None)
    assert relabelled(pushed[None], later[None]["next"], MOVED, ENV) is None


def test_goals_go_by_row() -> None:
    """Each moved row takes its own place, whichever rows are matched."""
    nodes, start = (True, True, True), torch.tensor([[0.0, 0.0], [0.2, 0.0], [-0.2, 0.0]])
    pushed = push(
        moved((0.06, 0.0), (0.0, 0.03), (0.0, -0.06), start=start),
        start=start,
        before=nodes,
        goal=nodes,
        matched=(True, False, True),
    )
    after = only(pushed)
    wanted = torch.tensor([[0.06, 0.0], [0.2, 0.03], [-0.2, -0.06]])
    torch.testing.assert_close(after["goal"].position, wanted)
    assert after["goal"].sdf[:, 0, 0].tolist() == [20.0, 31.0, 22.0]
    # Rows 0 and 2 come 60 mm nearer; what row 1 comes to is not its own goal.
    assert float(after["next", "reward"]) == pytest.approx(30 * 0.12 - 0.02, abs=1e-5)
    assert not bool(after["next", "success"])


# ------------------------------------------------------------------ which moment


def hindsight(name: str, per_push: int = 1) -> Hindsight:
    return Hindsight(HerConfig(name=name, min_displacement=MOVED, per_push=per_push), ENV)


def test_off_makes_nothing() -> None:
    assert Hindsight(HerConfig(name="off"), ENV)(push(moved((0.06, 0.0)))[None], EPISODE) is None


def test_next_is_the_push_itself() -> None:
    two = torch.stack([push(moved((0.06, 0.0))), push(moved((0.0, 0.0)))])
    made = hindsight("next")(two, torch.tensor([0, 0]))
    assert made is not None
    assert len(made) == 1


def goals_of(made: TensorDictBase) -> set[tuple[float, ...]]:
    return {tuple(round(x, 3) for x in goal) for goal in made["goal"].position[:, 0].tolist()}


def test_future_waits_for_the_episodes_end() -> None:
    torch.manual_seed(0)
    future = hindsight("future", per_push=20)
    first = push(moved((0.06, 0.0)))
    last = push(moved((0.0, 0.1)), terminated=True)
    assert future(first[None], EPISODE) is None
    made = future(last[None], EPISODE)
    assert made is not None
    assert goals_of(made) == {(0.06, 0.0), (0.0, 0.1)}
    of_last = made["next", "scene"].position[:, 0, 1] > 0.09
    assert (made["goal"].position[of_last][:, 0, 1] > 0.09).all()  # never an earlier push
    assert future(first[None], EPISODE) is None  # the episode is forgotten


def test_future_keeps_episodes_apart() -> None:
    """Pushes of two processes come in turns."""
    torch.manual_seed(0)
    future = hindsight("future", per_push=20)
    pushes = torch.stack([push(moved((0.06, 0.0))), push(moved((0.0, 0.1)))])
    assert future(pushes, torch.tensor([4, 7])) is None
    made = future(push(moved((0.07, 0.0)), terminated=True)[None], torch.tensor([7]))
    assert made is not None
    assert goals_of(made) == {(0.0, 0.1), (0.07, 0.0)}


def test_an_unfinished_episode_goes_on_from_a_checkpoint() -> None:
    """The process that goes on numbers its episodes anew."""
    before, after = hindsight("future", per_push=20), hindsight("future", per_push=20)
    assert before(push(moved((0.06, 0.0)))[None], torch.tensor([3])) is None
    after.load_state_dict(before.state_dict())
    torch.manual_seed(0)
    last = push(moved((0.0, 0.1)), terminated=True)
    made = after(last[None], EPISODE)
    assert made is not None
    assert isinstance(made["goal"], Scene)
    assert isinstance(made["next", "scene"], Scene)
    assert goals_of(made) == {(0.06, 0.0), (0.0, 0.1)}
    torch.manual_seed(0)
    there = before(last[None], torch.tensor([3]))
    assert there is not None
    assert (made == there).all()
    assert len(made) == 40


def test_an_episode_that_is_not_gone_on_with_is_forgotten() -> None:
    future = hindsight("future", per_push=20)
    future(push(moved((0.06, 0.0)))[None], EPISODE)
    future.load_state_dict(future.state_dict())
    future.forget_episode()
    made = future(push(moved((0.0, 0.1)), terminated=True)[None], EPISODE)
    assert made is not None
    assert goals_of(made) == {(0.0, 0.1)}
