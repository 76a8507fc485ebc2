"""The task: what is seen of it, what it remembers, and how an episode ends."""

from contextlib import closing

import mujoco
import numpy as np
import pytest
from configs import real_config
from conftest import Envs
from dm_control.mujoco import engine, wrapper
from toys import BALL, BOX, CAN, SLAB, act, begin, lay_out, toy_env

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError
from sdfgcn.registry import ROBOTS
from sdfgcn.sim.arena import CAMERA, GROUP_SCENE
from sdfgcn.sim.episode import draw_episode
from sdfgcn.task.camera import camera_model
from sdfgcn.task.push_space import PushPlan
from sdfgcn.task.world import PushResult

DIRECTIONS = 8


@pytest.fixture(scope="module", params=sorted(ROBOTS))
def env(request: pytest.FixtureRequest, toys_of: Envs) -> RearrangementEnv:
    """Only what the robot has a part in: seeing, and being out of the way."""
    return toys_of(request.param)


@pytest.fixture(scope="module")
def toys(toys_of: Envs) -> RearrangementEnv:
    return toys_of("gripper")


def owners(env: RearrangementEnv) -> set[str]:
    """Names of the models that the picture shows."""
    model = env.world.physics.model
    geoms = set(env.world.renderer.geom_ids().ravel()) - {-1}
    return {model.id2name(int(geom), "geom").split("/")[0] for geom in geoms}


# ------------------------------------------------------------------ the picture


def test_picture_shows_table_and_props_and_nothing_else(env):
    lay_out(env, [BALL, BOX], [(-0.1, 0.0), (0.1, 0.2)])
    assert owners(env) == {"ball", "box"}
    lay_out(env, [CAN], [(0.0, 0.1)])
    assert owners(env) == {"can"}
    # The rest is the table, all over the picture.
    rest = env.world.renderer.geom_ids() == -1
    assert rest.sum() > 8000 and env.world.renderer.pixels()[rest].min() > 50


def test_geom_ids_are_those_of_dm_control(env):
    lay_out(env, [BALL, BOX, CAN], [(-0.15, 0.0), (0.15, 0.0), (0.0, 0.25)])
    physics = env.world.physics
    option = wrapper.MjvOption()
    option.geomgroup[:] = np.arange(6) == GROUP_SCENE
    camera = engine.Camera(physics, 96, 96, camera_id=CAMERA)
    segments = camera.render(segmentation=True, scene_option=option)
    assert len(np.unique(segments[..., 0])) == 4
    np.testing.assert_array_equal(env.world.renderer.geom_ids(), segments[..., 0])


def test_robot_is_never_in_the_picture(env):
    lay_out(env, [BOX], [(0.0, 0.1)])
    physics, robot = env.world.physics, env.world.task.robot
    before = env.world.renderer.pixels(), env.world.renderer.geom_ids()
    # Right above the box, in front of the camera.
    robot.place(physics, robot.solve(np.array([0.0, 0.1, 0.06, 0.0])))
    physics.forward()
    np.testing.assert_array_equal(env.world.renderer.pixels(), before[0])
    np.testing.assert_array_equal(env.world.renderer.geom_ids(), before[1])


def test_parked_prop_is_not_drawn_even_in_the_middle(toys):
    lay_out(toys, [BOX], [(0.0, 0.1)])
    physics = toys.world.physics
    before = toys.world.renderer.geom_ids()
    physics.data.qpos[toys.world.task._qpos[BALL]] = [0.0, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]
    physics.forward()
    np.testing.assert_array_equal(toys.world.renderer.geom_ids(), before)


def test_slots_follow_the_episode_not_the_catalogue(toys):
    lay_out(toys, [CAN, BOX, BALL], [(-0.15, 0.0), (0.15, 0.0), (0.0, 0.25)])
    model, slots = toys.world.physics.model, toys.world.task.slot_of_geom
    named = {
        model.id2name(int(geom), "geom").split("/")[0]: int(slots[geom])
        for geom in np.flatnonzero(slots >= 0)
    }
    assert named == {"can": 0, "box": 1, "ball": 2}
    assert slots[-1] == -1  # "no geom" belongs to nobody
    masks = toys.episode_start.start.scene.masks[:3].numpy()
    rows, columns = (
        [np.flatnonzero(mask.any(axis=axis)).mean() for mask in masks] for axis in (1, 0)
    )
    assert columns[0] < columns[2] < columns[1]  # x grows to the right
    assert rows[2] < min(rows[0], rows[1])  # y grows upwards


def test_masks_follow_the_geom_to_slot_table(toys, monkeypatch):
    lay_out(toys, [CAN, BOX, BALL], [(-0.15, 0.0), (0.15, 0.0), (0.0, 0.25)])
    can, box, slab = toys.world.task._visuals[[CAN, BOX, SLAB]]
    # The slab is not in this episode; -1 is "nothing there", and nothing shows the ball.
    ids = np.array([[can, can, box], [slab, -1, slab], [box, can, -1]])
    monkeypatch.setattr(toys.world.renderer, "geom_ids", lambda: ids)
    masks = toys.world.look().true_masks()
    assert masks.shape == (3, 3, 3)
    assert masks[0].tolist() == [[True, True, False], [False] * 3, [False, True, False]]
    assert masks[1].tolist() == [[False, False, True], [False] * 3, [True, False, False]]
    assert not masks[2].any()


@pytest.mark.parametrize("seed", range(4))
def test_mask_centres_project_back_onto_the_objects(env_of: Envs, seed):
    env = env_of("robot=gripper", "n_objects=6")
    env.reset_episode(seed)
    start = env.episode_start.start
    for mask, pose in zip(start.scene.masks[:6].numpy(), start.poses, strict=True):
        rows, columns = np.nonzero(mask)
        middle = [columns.mean() + 0.5, rows.mean() + 0.5]
        point = env.world.camera.back_project(middle, pose[2])
        assert np.linalg.norm(point[:2] - pose[:2]) < 0.02


def test_camera_sees_all_of_the_allowed_region():
    config = real_config("objects=household").env
    camera, arena = camera_model(config.arena), config.arena
    corners = [(x, y, z) for x in arena.range_x for y in arena.range_y for z in (0.0, 0.06)]
    pixels = camera.project(corners)
    assert ((pixels >= 0) & (pixels <= arena.image_size)).all()
    assert arena.image_size == 96
    # Tilted 30 degrees from straight down.
    assert np.degrees(np.arccos(camera.rotation[2, 2])) == pytest.approx(30.0)


# ------------------------------------------------------------------ colours and parking


def test_props_have_the_episodes_colours(toys):
    lay_out(toys, [BALL, BOX], [(-0.1, 0.0), (0.1, 0.2)])
    model, task = toys.world.physics.model, toys.world.task
    np.testing.assert_allclose(
        model.geom_rgba[task._visuals[[BALL, BOX]]], task.episode.colors, atol=1e-6
    )


def test_parked_props_touch_nothing_and_sleep(toys):
    lay_out(toys, [BOX], [(0.0, 0.1)])
    physics, task = toys.world.physics, toys.world.task
    physics.data.qvel[task._qvel[BOX, 0]] = 0.1
    mujoco.mj_step(physics.model.ptr, physics.data.ptr, 1)
    trees = physics.model.body_treeid[task._bodies]
    asleep = physics.data.tree_asleep[trees] >= 0
    assert asleep.tolist() == [False, True, True, True]
    # A parked prop brought to the table stays in the air, out of reach of everything.
    physics.data.qpos[task._qpos[SLAB]] = [0.0, 0.1, 0.02, 1.0, 0.0, 0.0, 0.0]
    physics.forward()
    touching = np.unique(physics.data.contact.geom)
    assert task._visuals[SLAB] not in touching
    assert not np.isin(task._pieces[task._piece_props == SLAB], touching).any()


# ------------------------------------------------------------------ how an episode goes


def test_success_ends_the_episode_with_its_bonus(toys):
    # Pushed 5 cm along x, the box ends about 4 cm short of its goal.
    td = lay_out(toys, [BOX], [(-0.1, 0.1)], [(-0.01, 0.1)])
    after = act(toys, td, 0)
    left = float(np.linalg.norm(toys.last_step.after.poses[0, :2] - [-0.01, 0.1]))
    assert left < 0.05
    assert after["success"].item() and after["terminated"].item()
    assert not after["truncated"].item() and not after["out_of_range"].item()
    assert after["reward"].item() == pytest.approx(30 * (0.09 - left) - 0.02 + 10, abs=1e-3)
    assert toys.last_step.distances.tolist() == pytest.approx([left])
    assert after["pushes"].item() == 1


def test_success_needs_every_object_at_once(toys):
    places = [(-0.1, 0.1), (0.15, 0.0)]
    td = lay_out(toys, [BOX, BALL], places, [(-0.01, 0.1), (0.15, 0.051)])
    after = act(toys, td, 0)
    assert toys.last_step.distances[0] < 0.05 and toys.last_step.distances[1] > 0.05
    assert not after["success"].item() and not after["done"].item()
    td = lay_out(toys, [BOX, BALL], places, [(-0.01, 0.1), (0.15, 0.049)])
    after = act(toys, td, 0)
    assert after["success"].item() and after["done"].item()


def test_out_of_range_ends_the_episode_with_its_penalty(toys):
    # 2 cm from the edge at x = 0.31; the push heads outwards.
    td = lay_out(toys, [BOX], [(0.29, 0.1)], [(0.15, 0.1)])
    after = act(toys, td, 0)
    x, y = toys.last_step.after.poses[0, :2]
    assert x > 0.31
    assert after["out_of_range"].item() and after["terminated"].item()
    assert not after["success"].item() and not after["truncated"].item()
    progress = 30 * (0.14 - np.hypot(x - 0.15, y - 0.1))
    terms = toys.last_step.reward_terms
    assert terms["progress"] == pytest.approx(progress, abs=1e-6)
    assert after["reward"].item() == pytest.approx(max(progress - 0.02, -1.0) - 2.0, abs=1e-5)


def test_reward_counts_every_object_that_moved(toys):
    # The box pushes the can on: both come nearer to goals on the right.
    td = lay_out(toys, [BOX, CAN], [(-0.1, 0.1), (-0.03, 0.1)], [(0.2, 0.1), (0.25, 0.2)])
    before = np.array([0.3, np.hypot(0.28, 0.1)])
    after = act(toys, td, 0)
    assert (toys.last_step.distances < before - 0.02).all()
    wanted = 30 * (before.sum() - toys.last_step.distances.sum()) - 0.02
    assert after["reward"].item() == pytest.approx(wanted, abs=1e-3)


# ------------------------------------------------------------------ what is not seen


def away(env: RearrangementEnv, *slots: int) -> None:
    """Put objects far outside the picture, behind the environment's back."""
    task, physics = env.world.task, env.world.physics
    poses = task.poses(physics)
    poses[list(slots), 0] = 1.0 + 0.2 * np.arange(len(slots))
    task.set_poses(physics, poses)


def test_object_that_vanishes_is_masked_and_costs(toys):
    td = lay_out(toys, [BOX, BALL, CAN], [(-0.1, 0.1), (0.1, 0.1), (0.0, 0.25)])
    assert td["scene", "node_mask"].tolist() == [True] * 3 + [False] * 5
    away(toys, 1)
    after = act(toys, td, 0)
    assert after["scene", "node_mask"].tolist() == [True, False, True] + [False] * 5
    legal = after["action_mask"].view(-1, DIRECTIONS)
    assert legal[0].any() and legal[2].any() and not legal[1].any()
    assert (after["scene", "sdf"][1] == 0).all() and (after["scene", "sdf"][[0, 2]] != 0).any()
    terms = toys.last_step.reward_terms
    assert (terms["vanished"], terms["none_left"]) == (-0.5, 0.0)
    # Slot 2 is still slot 2, though its mask is now the second one found.
    again = act(toys, after, 2 * DIRECTIONS)
    assert toys.last_step.push.result.status == "done"
    # It vanished once.
    assert toys.last_step.reward_terms["vanished"] == 0.0
    assert again["scene", "node_mask"].tolist() == after["scene", "node_mask"].tolist()


def test_hidden_object_does_not_shift_the_others(toys, monkeypatch):
    """Slot 0 is covered up, as by an object above it; nothing has left the table."""
    seen = toys.world.renderer.geom_ids
    places = [(-0.1, 0.1), (0.1, 0.1), (0.0, 0.25)]
    td = lay_out(toys, [BOX, BALL, CAN], places)
    hidden = toys.world.task._visuals[BOX]
    monkeypatch.setattr(
        toys.world.renderer, "geom_ids", lambda: np.where(seen() == hidden, -1, seen())
    )
    poses = toys.world.poses()
    td = act(toys, td, 63)  # nothing moves; the picture is taken anew
    assert toys.last_step.reward_terms["vanished"] == -0.5
    assert td["scene", "node_mask"][:3].tolist() == [False, True, True]
    assert not td["done"].item()
    # What cannot be seen cannot be pushed.
    td = act(toys, td, 0)
    assert toys.last_step.push.result.status == "unreachable"
    np.testing.assert_array_equal(toys.last_step.after.poses, poses)
    assert toys.last_step.push.row == 0
    # The ball is slot 1, and the first mask of the plan.
    td = act(toys, td, 1 * DIRECTIONS + 2)
    moved = np.linalg.norm((toys.last_step.after.poses - poses)[:, :2], axis=1)
    assert moved[1] > 0.04 and max(moved[0], moved[2]) < 1e-3
    monkeypatch.undo()
    td = act(toys, td, 63)
    assert td["scene", "node_mask"][:3].tolist() == [True] * 3
    assert toys.last_step.reward_terms["vanished"] == 0.0


def test_nothing_left_ends_the_episode(toys, monkeypatch):
    """Everything is covered up, but nothing has left the table."""
    td = lay_out(toys, [BOX, BALL], [(-0.1, 0.1), (0.1, 0.1)])
    with monkeypatch.context() as patch:
        patch.setattr(toys.world.renderer, "geom_ids", lambda: np.full((96, 96), -1))
        after = act(toys, td, 63)
        assert after["terminated"].item() and after["done"].item()
        assert not after["out_of_range"].item()
        assert not after["scene", "node_mask"].any() and (after["scene", "sdf"] == 0).all()
        assert toys.last_step.reward_terms["none_left"] == -1.0
        assert toys.last_step.reward_terms["vanished"] == -1.0
        # A sampler still finds an action to take.
        assert after["action_mask"].any()
        assert after["action_mask"][toys.rand_action(after.clone())["action"]]


def test_everything_swept_off_the_table(toys):
    td = lay_out(toys, [BOX, BALL], [(-0.1, 0.1), (0.1, 0.1)])
    away(toys, 0, 1)
    after = act(toys, td, 63)
    assert after["out_of_range"].item() and after["terminated"].item()
    assert not after["scene", "node_mask"].any()
    assert toys.last_step.reward_terms["out_of_range"] == -2.0


def test_boxed_in_objects_may_be_tried_in_vain(toys, monkeypatch):
    monkeypatch.setattr(toys.push_space, "plan", none_legal)
    td = lay_out(toys, [BOX, BALL], [(-0.1, 0.1), (0.1, 0.1)])
    assert td["action_mask"].view(-1, DIRECTIONS).any(1).tolist() == [True] * 2 + [False] * 6


def none_legal(masks, *rest):
    m = len(masks)
    return PushPlan(
        np.zeros((m, 2)),
        np.full((m, DIRECTIONS, 2), np.nan),
        np.zeros((m, DIRECTIONS)),
        np.zeros((m, DIRECTIONS), dtype=bool),
    )


# ------------------------------------------------------------------ placing


def test_episode_starts_where_it_was_drawn_and_lies_still(env_of: Envs):
    env = env_of("robot=gripper", "n_objects=6")
    for seed in range(3):
        episode = draw_episode(seed, env.world.catalogue, env.config)
        env.reset_episode(seed)
        start = env.episode_start.start.poses
        # Settling is not moving: the rests are stable.
        assert np.linalg.norm((start - episode.start)[:, :3], axis=1).max() < 0.003
        goal = begin(env, episode)["goal", "position"][:6]
        np.testing.assert_allclose(goal, episode.goal[:, :2], atol=1e-6)
        assert [model.name for model in env.episode_start.truth.objects] == [
            env.world.catalogue[i].name for i in episode.objects
        ]


def test_an_unstable_simulation_names_its_episode(monkeypatch):
    """MuJoCo itself only warns, and goes on from the model's own initial state."""

    def explode(physics, *rest):
        physics.data.qvel[:] = 1e12
        mujoco.mj_step(physics.model.ptr, physics.data.ptr)
        return PushResult("done", np.zeros(3), np.zeros(3))

    with closing(toy_env(real_config("objects=household", "robot=gripper").env)) as env:
        task, seed = env.world.task, 41
        begin(env, draw_episode(seed, env.world.catalogue, env.config))
        monkeypatch.setattr(task._primitive, "execute", explode)
        with pytest.raises(SdfgcnError, match=r"^The simulation became unstable in the episode of"):
            env.world.execute(None)
        monkeypatch.setattr(task, "_settle", explode)
        with pytest.raises(SdfgcnError, match=rf"the episode of seed {seed}: use a smaller env"):
            env.world.begin(task.episode)
