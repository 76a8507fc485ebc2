"""Films, read back; and that filming an episode changes nothing in it."""

from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
from configs import real_config
from moments import ENV, episode_start, episode_steps, record, viz_of
from PIL import Image, ImageSequence

from sdfgcn import compose
from sdfgcn.agents import build_agent
from sdfgcn.errors import SdfgcnError
from sdfgcn.evaluation.play import play_episode
from sdfgcn.registry import RECORDERS, ROBOTS
from sdfgcn.viz.records import Records
from sdfgcn.viz.video_comparison import film_comparison
from sdfgcn.viz.video_film import Film, evenly, film_camera

VIZ = viz_of("video")
HELD = round(VIZ.hold * VIZ.fps)  # 3 frames
MOVING = VIZ.push_frames + VIZ.jump_frames  # 4 frames a push


def frames_of(path):
    """The size in pixels (width, height), frames per second, and frames of an MP4."""
    frames = imageio_ffmpeg.read_frames(str(path))
    about = next(frames)
    width, height = about["size"]
    read = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in frames]
    return about["size"], about["fps"], read


def play(env, recorder=None):
    config = real_config("model=rule_based", "objects=household")
    agent = build_agent(config, np.random.default_rng(3))
    try:
        return replace(play_episode(env, agent, 0, 11, recorder), wall_s=0.0)
    finally:
        env.record = False


# ------------------------------------------------------------------ filming changes nothing


@pytest.mark.parametrize("robot", ROBOTS)
def test_recorded_or_not_an_episode_is_the_same(env_of, robot):
    env = env_of(f"robot={robot}", "n_objects=2", "env.pushes_per_object=3")
    records = Records()
    recorded = play(env, records)
    start, steps = records.episode
    plain = play(env)
    assert recorded == plain
    assert len(steps) == plain.pushes
    assert env.last_step.push.result.motion is None
    np.testing.assert_array_equal(env.last_step.after.poses, steps[-1].after.poses)

    before = start.start.poses
    for step in steps:
        motion = step.push.result.motion
        assert motion.joints.shape[0] == motion.objects.shape[0]
        if step.push.result.status == "done":
            np.testing.assert_array_equal(motion.objects[0], before)
            np.testing.assert_allclose(motion.objects[-1], step.after.poses, atol=1e-9)
            assert np.ptp(motion.joints, axis=0).max() > 0.01
        before = step.after.poses


@pytest.fixture(scope="module")
def filmed(env_of, tmp_path_factory):
    """A film of two pushes, and the row of its episode."""
    env = env_of("robot=gripper", "n_objects=2", "env.pushes_per_object=1")
    path = tmp_path_factory.mktemp("film") / "episode_000"
    with RECORDERS["video"](path, env.config, VIZ) as recorder:
        row = play(env, recorder)
    return env, path.with_suffix(".mp4"), row


def test_filmed_or_not_an_episode_is_the_same(filmed):
    env, _, row = filmed
    assert play(env) == row


def test_frames_and_size_of_a_film(filmed):
    _, path, row = filmed
    size, fps, frames = frames_of(path)
    assert (size, fps) == ((200, 160), 12)
    assert row.pushes == 2
    assert len(frames) == HELD + 2 * MOVING + HELD
    assert [entry.name for entry in path.parent.iterdir()] == ["episode_000.mp4"]
    moved = np.abs(frames[HELD].astype(int) - frames[HELD + 2]).max(axis=-1)
    assert (moved > 40).sum() > 30  # pixels: the gripper came into the picture


# ------------------------------------------------------------------ what the frames show


def test_objects_are_where_they_lie():
    start = episode_start()
    viz = replace(VIZ, ghost_alpha=0.0, camera_distance=3.0, width=400, height=400)
    film = Film(ENV, viz, start)
    shot = film._shot
    picture = np.asarray(shot.picture(start.start, shot.home, start.start.poses)).astype(int)
    for slot, channel in ((0, 0), (2, 2)):  # the red cube and the blue one
        u, v = np.round(shot.project(start.start.poses[slot, :3])).astype(int)
        pixel = picture[v, u]
        assert pixel.argmax() == channel
        assert pixel[channel] > 2 * np.delete(pixel, channel).max()
    film.close()


def test_captions_tell_the_distances():
    film = Film(ENV, VIZ, episode_start())
    words = "".join(word.text for word in film._distance_words(np.array([0.03, 0.25, np.nan])))
    assert words.split() == ["mm:", "0", "30", "✓", "1", "250", "2", "-"]
    # The first cube starts a quarter of a metre from its goal, as the second does.
    poses = episode_start().start.poses
    np.testing.assert_allclose(film._distances(poses, None), [0.25, 0.25, 1.0])
    film.close()


def test_the_camera_looks_at_its_target():
    viz = replace(VIZ, camera_azimuth=90.0, camera_elevation=30.0, camera_distance=2.0)
    camera = film_camera(viz, 100)
    target = np.array(viz.camera_target)
    np.testing.assert_allclose(camera.position - target, [0, np.sqrt(3), 1], atol=1e-9)
    np.testing.assert_allclose(camera.project(target), [50, 50])
    # From the far side of the table, +x is on the left, and up is up.
    assert camera.project(target + np.array([0.1, 0, 0]))[0] < 50
    assert camera.project(target + np.array([0, 0, 0.1]))[1] < 50


def test_frames_are_spread_over_what_happens():
    robot = np.array([[0.0], [1.0], [2.0], [2.0], [2.0]])
    poses = np.zeros((5, 1, 7))
    poses[:, 0, 0] = [0, 0, 0, 1, 2]
    # Half of what happens is the robot's way, half the object's: 0, 0.5, 1, 1.5, 2.
    assert evenly(robot, poses, 4).tolist() == [1, 2, 3, 4]
    assert evenly(robot, poses, 2).tolist() == [2, 4]
    assert evenly(robot[:1], poses[:1], 3).tolist() == [0, 0, 0]


def test_without_truth_the_cameras_pictures_are_shown(tmp_path):
    steps = [replace(s, distances=np.array([1.0, 0.0, np.nan])) for s in episode_steps(known=False)]
    record(tmp_path / "a", episode_start(known=False), steps, name="video")
    _, _, frames = frames_of(tmp_path / "a.mp4")
    assert len(frames) == HELD + 2 * MOVING + HELD
    # The picture is grey (100 of 255) in the middle, with black on both sides.
    assert np.abs(frames[0][20, 100].astype(int) - 100).max() < 12
    assert frames[0][20, 5].max() < 12


@pytest.mark.parametrize("kind", ["gif", "webp"])
def test_formats_that_a_readme_shows(kind, tmp_path):
    with RECORDERS["video"](tmp_path / "a", ENV, replace(VIZ, format=kind)) as recorder:
        recorder.start(episode_start())
        for step in episode_steps():
            recorder.step(step)
    with Image.open(tmp_path / f"a.{kind}") as film:
        assert film.size == (200, 160)
        # Pillow knows how long a frame lasts once it is loaded, as by copying it.
        lasts = sum(frame.copy().info["duration"] for frame in ImageSequence.Iterator(film))
    # Equal frames may have become one that lasts longer; GIF counts in hundredths of a second.
    assert lasts == pytest.approx((HELD + 2 * MOVING + HELD) * 1000 / 12, rel=0.05)


def test_side_by_side(tmp_path):
    two = {"long": (episode_start(), episode_steps()), "short": (episode_start(), [])}
    path = film_comparison(tmp_path / "a", ENV, VIZ, two)
    size, _, frames = frames_of(path)
    assert size == (200 + 2 + 200, 160)
    assert len(frames) == HELD + 2 * MOVING + HELD
    # Who is done shows the outcome until the end.
    still = np.abs(frames[2 * HELD][:, 202:].astype(int) - frames[-1][:, 202:]).mean()
    moved = np.abs(frames[2 * HELD][:, :200].astype(int) - frames[-1][:, :200]).mean()
    assert still < 2 < moved


# ------------------------------------------------------------------ files and errors


def test_an_interrupted_film_leaves_no_file(tmp_path):
    with pytest.raises(KeyboardInterrupt), RECORDERS["both"](tmp_path / "a", ENV, VIZ) as recorder:
        recorder.start(episode_start())
        recorder.step(episode_steps()[0])
        raise KeyboardInterrupt
    assert not [entry.name for entry in tmp_path.iterdir() if entry.suffix != ".partial"]


def test_an_unwritable_place(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(SdfgcnError, match="Cannot write the film"):
        RECORDERS["video"](tmp_path / "file" / "a", ENV, VIZ).start(episode_start())


def test_a_missing_package_is_told_before_anything_is_played(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SdfgcnError, match=r"pip install -e '\.\[video\]'"):
        compose.load_config("viz=video")
    assert compose.load_config("viz=video", "viz.format=gif").viz.format == "gif"
