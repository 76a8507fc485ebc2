"""Every perception in the environment, and what happens when it sees wrong."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from conftest import Envs
from recordings import Recording
from torchrl.envs.utils import check_env_specs
from toys import act, assert_equal

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.models.graph import EDGES, adjacency_matrix
from sdfgcn.perception.base import Perception, detected
from sdfgcn.perception.vision import rows_of
from sdfgcn.registry import PERCEPTIONS, RECORDERS


@pytest.fixture(scope="module", params=sorted(PERCEPTIONS))
def env(request: pytest.FixtureRequest, env_of: Envs) -> RearrangementEnv:
    return env_of("robot=gripper", "n_objects=3", f"perception={request.param}")


def test_specs(env):
    check_env_specs(env)


def test_goes_on_alike_after_a_save_and_restore(env):
    td = env.reset_episode(5)
    td = act(env, td, int(np.flatnonzero(td["action_mask"].numpy())[3]))
    state = env.save_state()
    action = int(np.flatnonzero(td["action_mask"].numpy())[-2])
    first = act(env, td, action)
    env.reset_episode(6)
    again = act(env, env.restore_state(state), action)
    assert_equal(first, again)


def test_every_detection_has_its_features_and_its_place(env):
    td = env.reset_episode(7)
    scene, nodes, goal_nodes = td["scene"], td["scene", "node_mask"], td["goal", "node_mask"]
    assert nodes.any() and goal_nodes.any()
    assert (scene.sdf[nodes].flatten(1).min(dim=1).values < 0).all()
    assert (scene.sdf[~nodes] == 0).all() and (scene.center[~nodes] == 0).all()
    assert td["matched"].any()
    assert not (td["matched"] & ~nodes).any()
    assert not (td["matched"] & ~goal_nodes).any()
    # A detected centre lies on its object.
    assert (scene.center - scene.position)[nodes].norm(dim=1).max() < 0.05


def test_recording_shows_masks_sdfs_and_matches(env, tmp_path):
    path = tmp_path / "episode.rrd"
    env.record = True
    try:
        td = env.reset_episode(8)
        with RECORDERS["rerun"](path, env.config) as recorder:
            recorder.start(env.episode_start)
            act(env, td, int(td["action_mask"].int().argmax()))
            recorder.step(env.last_step)
    finally:
        env.record = False
    recording = Recording(path)
    seen = recording.entities()
    for entity in ("/world/camera/picture", "/world/camera/masks", "/world/camera/graph", "/goal"):
        assert any(each.startswith(entity) for each in seen), entity
    # One SDF for each object that is seen to start with, and as many matches drawn as there are.
    assert sum(each.startswith("/sdf/scene/") and each.count("/") == 3 for each in seen) >= 2
    assert env.last_step.after.matched.any()


# ------------------------------------------------------------------ what may go wrong

# True masks to what is seen instead: masks by row, and which rows are matched with the goal's.
Change = Callable[[np.ndarray], tuple[np.ndarray, list[bool]]]


class Scripted(Perception):
    """True masks, changed as the test says; the goal's may be changed too."""

    goal_change: Change | None = None
    change: Change | None = None

    def see_goal(self, view):
        masks = view.true_masks()
        return masks if self.goal_change is None else self.goal_change(masks)[0]

    def see(self, view):
        masks = view.true_masks()
        if self.change is None:
            return masks, np.ones(len(masks), dtype=bool)
        masks, matched = self.change(masks)
        return masks, np.array(matched, dtype=bool)


def lose_one(masks):
    return np.stack([np.zeros_like(masks[0]), *masks[1:]]), [False, True, True]


def merge_two(masks):
    return np.stack([masks[0] | masks[1], np.zeros_like(masks[0]), masks[2]]), [True, False, True]


def split_one(masks):
    left = masks[0].copy()
    left[:, np.flatnonzero(masks[0].any(axis=0)).mean().astype(int) :] = False
    return np.stack([left, *masks[1:], masks[0] & ~left]), [True, True, True, False]


def lose_all(masks):
    return masks[:0], []


def hide_all(masks):
    return np.zeros_like(masks), [True] * len(masks)


@pytest.fixture
def scripted(env_of: Envs) -> Iterator[RearrangementEnv]:
    env = env_of("robot=gripper", "n_objects=3")
    real = env._perception
    env._perception = Scripted(env.config.perception, env.config.max_objects)
    yield env
    env._perception = real


@pytest.mark.parametrize(
    ("change", "detections", "matches"),
    [(lose_one, 2, 2), (merge_two, 2, 2), (split_one, 4, 3), (lose_all, 0, 0), (hide_all, 0, 0)],
)
def test_wrong_masks_are_ordinary_observations(scripted, change, detections, matches):
    scripted._perception.change = change
    td = scripted.reset_episode(1)
    nodes = td["scene", "node_mask"]
    assert nodes.sum() == detections
    assert td["matched"].sum() == matches
    assert not (td["matched"] & ~nodes).any()
    assert td["action_mask"].any()
    # Legal are pushes of detections alone; where there is none, row 0 stands in.
    legal = scripted.push_space.by_direction(td["action_mask"]).any(dim=-1)
    if detections:
        assert not (legal & ~nodes).any()
    for edges in EDGES:
        graph = adjacency_matrix(nodes, td["goal", "node_mask"], td["matched"], edges)
        assert graph[: len(nodes), len(nodes) :].sum() == matches
    after = act(scripted, td, int(td["action_mask"].int().argmax()))
    assert after["terminated"].item() == (detections == 0)
    terms = scripted.last_step.reward_terms
    assert terms["none_left"] == (-1.0 if detections == 0 else 0.0)


def test_an_object_that_vanishes_costs_its_penalty(scripted):
    td = scripted.reset_episode(2)
    scripted._perception.change = lose_one
    after = act(scripted, td, int(td["action_mask"].int().argmax()))
    assert scripted.last_step.reward_terms["vanished"] == pytest.approx(-0.5)
    assert not after["terminated"].item() or after["success"].item()
    # It stays lost: once is enough.
    act(scripted, after, int(after["action_mask"].int().argmax()))
    assert scripted.last_step.reward_terms.get("vanished", 0.0) == 0.0


@pytest.mark.parametrize(
    ("goal_change", "rows", "matches"),
    [
        (lose_one, [1, 2], 2),
        (merge_two, [0, 2], 2),
        (split_one, [0, 1, 2, 3], 3),
        (lose_all, [], 0),
    ],
)
def test_wrong_masks_of_the_goal(scripted, goal_change, rows, matches):
    scripted._perception.goal_change = goal_change
    td = scripted.reset_episode(3)
    assert np.flatnonzero(td["goal", "node_mask"]).tolist() == rows
    # Nothing is matched with a goal that is not there.
    assert not (td["matched"] & ~td["goal", "node_mask"]).any()
    assert td["matched"].sum() == matches
    act(scripted, td, int(td["action_mask"].int().argmax()))
    assert scripted.last_step.after.matched.sum() <= matches


def test_a_speck_is_no_detection():
    masks = np.zeros((3, 9, 9), dtype=bool)
    masks[0, :2, :2] = masks[1, 0, :3] = True
    assert detected(masks, 3).tolist() == [True, True, False]
    assert detected(masks, 4).tolist() == [True, False, False]


def test_rows_keep_their_goal():
    assert rows_of(np.array([2, 0, 1]), 3).tolist() == [2, 0, 1]
    # Two detections, three goals: rows of the goals they are matched with.
    assert rows_of(np.array([2, 0]), 3).tolist() == [2, 0]
    # Four detections, two goals: the others take the rows that are left over, in order.
    assert rows_of(np.array([-1, 1, -1, 0]), 2).tolist() == [2, 1, 3, 0]
    assert rows_of(np.array([-1, -1]), 0).tolist() == [0, 1]
    assert rows_of(np.zeros(0, dtype=int), 2).tolist() == []
