"""Every perception in the environment, and what happens when it sees wrong."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest
import torch
from conftest import Envs
from recordings import Recording
from torchrl.envs.utils import check_env_specs
from toys import act

from sdfgcn.config import N_DIRECTIONS
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.graph import EDGES, scene_graph
from sdfgcn.perception.perception import Perception
from sdfgcn.perception.vision import rows_of
from sdfgcn.registry import PERCEPTIONS, RECORDERS

KEYS = ("sdf", "goal_sdf", "node_mask", "correspondence", "center", "position", "action_mask")


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
    for key in KEYS:
        assert torch.equal(first[key], again[key]), key


def test_every_detection_has_its_features_and_its_place(env):
    td = env.reset_episode(7)
    nodes, goal_nodes = td["scene", "node_mask"], td["goal", "node_mask"]
    assert nodes.any() and goal_nodes.any()
    assert (td["scene", "sdf"][nodes].flatten(1).min(dim=1).values < 0).all()
    assert (td["scene", "sdf"][~nodes] == 0).all() and (td["scene", "center"][~nodes] == 0).all()
    matched = td["correspondence"] >= 0
    assert not (matched & ~nodes).any()
    assert goal_nodes[td["correspondence"][matched]].all()
    assert td["correspondence"][matched].unique().numel() == matched.sum()
    # A detected centre lies on its object.
    assert (td["scene", "center"] - td["scene", "position"])[nodes].norm(dim=1).max() < 0.05


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
    assert (env.last_step.after.correspondence >= 0).any()


# ------------------------------------------------------------------ what may go wrong

Change = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class Scripted(Perception):
    """True masks, changed as the test says; the goal's may be changed too."""

    goal_change: Change | None = None
    change: Change | None = None

    def see_goal(self, view):
        masks = view.true_masks()
        return masks if self.goal_change is None else self.goal_change(masks)[0]

    def see(self, view):
        masks = view.true_masks()
        matches = np.arange(len(masks))
        return (masks, matches) if self.change is None else self.change(masks)


def lose_one(masks):
    return masks[1:], np.array([1, 2])


def merge_two(masks):
    return np.stack([masks[0] | masks[1], masks[2]]), np.array([0, 2])


def split_one(masks):
    left = masks[0].copy()
    left[:, np.flatnonzero(masks[0].any(axis=0)).mean().astype(int) :] = False
    return np.stack([left, masks[0] & ~left, *masks[1:]]), np.array([0, -1, 1, 2])


def lose_all(masks):
    return masks[:0], np.zeros(0, dtype=int)


def hide_all(masks):
    return np.zeros_like(masks), np.arange(len(masks))


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
    assert td["scene", "node_mask"].sum() == detections
    assert (td["correspondence"] >= 0).sum() == matches
    assert td["action_mask"].any()
    # Legal are pushes of detections alone; where there is none, row 0 stands in.
    legal = td["action_mask"].view(-1, N_DIRECTIONS).any(dim=1)
    if detections:
        assert not (legal & ~td["scene", "node_mask"]).any()
    for edges in EDGES:
        graph = scene_graph(td, edges)
        assert graph.adjacency[: len(td["scene", "sdf"]), len(td["scene", "sdf"]) :].sum() == matches
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


@pytest.mark.parametrize("goal_change", [lose_one, merge_two, split_one, lose_all])
def test_wrong_masks_of_the_goal(scripted, goal_change):
    scripted._perception.goal_change = goal_change
    td = scripted.reset_episode(3)
    count = len(goal_change(np.ones((3, 9, 9), dtype=bool))[0])
    assert td["goal", "node_mask"].sum() == count
    matched = td["correspondence"][td["correspondence"] >= 0]
    assert td["goal", "node_mask"][matched].all()
    act(scripted, td, int(td["action_mask"].int().argmax()))


def test_rows_keep_their_goal():
    assert rows_of(np.array([2, 0, 1]), 3).tolist() == [2, 0, 1]
    # Two detections, three goals: rows of the goals they are matched with.
    assert rows_of(np.array([2, 0]), 3).tolist() == [2, 0]
    # Four detections, two goals: the others take the rows that are left over, in order.
    assert rows_of(np.array([-1, 1, -1, 0]), 2).tolist() == [2, 1, 3, 0]
    assert rows_of(np.array([-1, -1]), 0).tolist() == [0, 1]
    assert rows_of(np.zeros(0, dtype=int), 2).tolist() == []
