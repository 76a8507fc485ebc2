"""Recording changes nothing, and what it adds is what happened: the robot where it truly was."""

from collections.abc import Iterator

import numpy as np
import pytest
from configs import real_config
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

from sdfgcn.agents import build_agent
from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.envs.records import EpisodeStart, StepRecord
from sdfgcn.evaluation.play import play_episode
from sdfgcn.sim.robots.visible import simplified
from sdfgcn.task.world import PushCommand

OVERRIDES = ("objects=household", "model=released", "n_objects=2", "env.pushes_per_object=2")


class Kept:
    """Keeps what a recorder is given."""

    def start(self, episode: EpisodeStart) -> None:
        self.episode, self.steps = episode, []

    def step(self, step: StepRecord) -> None:
        self.steps.append(step)


@pytest.fixture(scope="module", params=["gripper", "ur5e"])
def played(request) -> Iterator[tuple]:
    """The same episode without and with a recorder, and what the recorder got."""
    config = real_config(*OVERRIDES, f"robot={request.param}")
    env = RearrangementEnv(config.env, seed=0)
    results, states, kept = [], [], Kept()
    for recorder in (None, kept):
        rng = np.random.default_rng(1)
        results.append(play_episode(env, build_agent(config, rng), 0, 5, recorder))
        states.append(env.save_state())
        if recorder is None:
            assert "_visible_robot" not in vars(env.world)  # its meshes cost time and memory
            assert env.last_step.push.result.motion is None
            assert env.episode_start.robot is None
    yield env, results, states, kept
    env.close()


def test_rows_are_the_same(played):
    _env, (plain, recorded), states, _kept = played
    assert recorded.wall_s >= 0.0
    for key in plain.__dataclass_fields__.keys() - {"wall_s"}:
        assert getattr(plain, key) == getattr(recorded, key), key
    assert states[0] == states[1]  # to the last bit


def test_the_robot_is_where_the_push_began_and_ended(played):
    """The lowest point of its meshes is the fingertips, which the result of the push tells."""
    _env, _, _, kept = played
    shape = kept.episode.robot
    assert len(kept.steps) >= 1
    pushed = [step for step in kept.steps if step.push.result.status == "done"]
    assert pushed
    for step in pushed:
        motion, result = step.push.result.motion, step.push.result
        assert motion.links.shape == (len(motion.phases), len(shape.links), 7)
        assert motion.objects.shape == (len(motion.phases), 2, 7)
        of_push = [t for t, phase in enumerate(motion.phases) if phase == "push"]
        for moment, place in ((of_push[0], result.start), (of_push[-1], result.end)):
            tip = lowest_point(shape.links, motion.links[moment])
            np.testing.assert_allclose(tip, place, atol=0.012)  # the fingers are 22 mm wide
        travel = np.linalg.norm(
            motion.links[of_push[-1], -1, :3] - motion.links[of_push[0], -1, :3]
        )
        assert travel == pytest.approx(np.linalg.norm(result.end - result.start), abs=0.006)


def lowest_point(links, poses) -> np.ndarray:
    """The middle of the points of the tool within a millimetre of the lowest."""
    link, pose = links[-1], poses[-1]  # the gripper is part of the last link
    turn = Rotation.from_quat(pose[3:], scalar_first=True)
    points = turn.apply(link.vertices) + pose[:3]
    return points[points[:, 2] < points[:, 2].min() + 0.002].mean(axis=0)


def test_the_objects_move_with_it(played):
    _, _, _, kept = played
    before = kept.episode.start.poses
    for step in kept.steps:
        motion = step.push.result.motion
        if len(motion.phases):
            np.testing.assert_allclose(motion.objects[0], before, atol=1e-3)
            left = np.linalg.norm((motion.objects[-1] - step.after.poses)[:, :2], axis=1)
            assert (left < 0.03).all()  # they only settle after the last moment
        before = step.after.poses


def test_an_explanation_is_what_the_agent_expects(played):
    _env, _, _, kept = played
    for step in kept.steps:
        told = step.explanation
        assert told.displacement.shape == (8, 2)
        assert told.deviation.shape == (8,)
        assert {scores.shape for scores in told.scores.values()} == {(8, 8)}
        # It expects the pushed object to go roughly where it is pushed.
        ahead = np.array([np.cos(step.push.angle), np.sin(step.push.angle)])
        assert told.displacement[step.push.row] @ ahead > 0.0


def test_a_push_that_cannot_begin_has_no_motion(played):
    env = played[0]
    env.world.watching = True
    result = env.world.execute(PushCommand(np.full(2, np.nan), 0.0, 0.0))
    env.world.watching = False
    assert result.status == "unreachable"
    assert len(result.motion.phases) == len(result.motion.links) == 0


@pytest.mark.parametrize("model", ["rule_based", "released checkpoint=sdfgcn"])
def test_most_agents_expect_nothing(model):
    config = real_config("objects=household", *f"model={model}".split())
    agent = build_agent(config, np.random.default_rng(0))
    assert agent.explain(TensorDict()) is None


def test_simplified_mesh_by_hand():
    """Two vertices in one cube become one, and a triangle that had both is gone."""
    vertices = np.array([[0.1, 0, 0], [0.3, 0, 0], [1.5, 0, 0], [0, 1.5, 0]])
    faces = np.array([[0, 2, 3], [1, 3, 2], [0, 1, 2]])
    points, left = simplified(vertices, faces, cell=1.0)
    assert sorted(map(tuple, points.tolist())) == [(0, 1.5, 0), (0.2, 0, 0), (1.5, 0, 0)]
    assert len(left) == 1  # the first two became the same
    np.testing.assert_allclose(points[left[0]], [[0.2, 0, 0], [1.5, 0, 0], [0, 1.5, 0]])
