"""The camera model against cases worked by hand, and against MuJoCo's own renderer."""

import math

import numpy as np
import pytest
from dm_control import mujoco

from sdfgcn.task.camera import CameraModel


def straight_down() -> CameraModel:
    """1 m above the table, 90 degrees of view: the picture shows 2 m, 48 pixels to the metre."""
    return CameraModel(np.array([0.0, 0.0, 1.0]), np.eye(3), fovy=math.pi / 2, size=96)


def tilted() -> CameraModel:
    """Looks 30 degrees off straight down, towards +y; picture right stays world x."""
    c, s = math.cos(math.pi / 6), math.sin(math.pi / 6)
    rotation = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return CameraModel(np.array([0.1, -0.5, 0.9]), rotation, fovy=math.radians(45), size=96)


@pytest.mark.parametrize(
    ("point", "pixel"),
    [
        ([0, 0, 0], [48, 48]),  # under the camera: the middle of the picture
        ([0.5, 0, 0], [72, 48]),  # 0.5 m along x: 24 pixels right
        ([0, 0.5, 0], [48, 24]),  # 0.5 m along y: 24 pixels up, towards row 0
        ([-1, 1, 0], [0, 0]),  # the far corner: the outer corner of the first pixel
        ([0.25, 0, 0.5], [72, 48]),  # twice as near, so half the way looks the same
    ],
)
def test_straight_down(point, pixel):
    assert straight_down().focal == pytest.approx(48)
    np.testing.assert_allclose(straight_down().project(point), pixel, atol=1e-9)
    np.testing.assert_allclose(straight_down().back_project(pixel, point[2]), point, atol=1e-9)


def test_tilted_by_30_degrees():
    camera = tilted()
    # The optical axis meets the table 0.9 * tan(30 degrees) ahead of the camera.
    ahead = 0.9 * math.tan(math.pi / 6)
    np.testing.assert_allclose(camera.project([0.1, -0.5 + ahead, 0]), [48, 48], atol=1e-9)
    # The point straight below lies 30 degrees under the axis, towards the last row.
    focal = 48 / math.tan(math.radians(22.5))
    below = [48, 48 + focal * math.tan(math.pi / 6)]
    np.testing.assert_allclose(camera.project([0.1, -0.5, 0]), below, atol=1e-9)
    # The middle of the top edge looks 30 + 22.5 degrees off straight down.
    top = [0.1, -0.5 + 0.9 * math.tan(math.radians(52.5)), 0]
    np.testing.assert_allclose(camera.back_project([48, 0]), top, atol=1e-9)


def test_back_project_undoes_project_for_any_batch_and_height():
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.3, 0.3, (4, 5, 3))
    pixels = tilted().project(points)
    assert pixels.shape == (4, 5, 2)
    np.testing.assert_allclose(tilted().back_project(pixels, points[..., 2]), points, atol=1e-9)


def test_no_answer_behind_the_camera():
    camera = straight_down()
    assert np.isnan(camera.project([[0, 0, 1.0], [0, 0, 2.0]])).all()
    assert np.isnan(camera.back_project([10, 10], height=2.0)).all()
    level = CameraModel(np.zeros(3), np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0.0]]), 1.0, 96)
    assert np.isnan(level.back_project([48, 48], height=0.5)).all()  # along the plane


def test_agrees_with_the_renderer():
    """Balls land where the model says, to a fifth of a pixel."""
    centres = np.array([[0.0, 0.0, 0.0], [0.25, 0.3, 0.05], [-0.3, -0.1, 0.1], [0.1, 0.2, 0.2]])
    balls = "".join(f'<geom type="sphere" size=".03" pos="{x} {y} {z}"/>' for x, y, z in centres)
    physics = mujoco.Physics.from_xml_string(
        f'<mujoco><worldbody>{balls}<camera name="c" pos="0 -.4 1" euler="30 0 0" fovy="45"/>'
        "</worldbody></mujoco>"
    )
    camera = CameraModel(
        physics.data.cam_xpos[0].copy(),
        physics.data.cam_xmat[0].reshape(3, 3).copy(),
        math.radians(physics.model.cam_fovy[0]),
        size=96,
    )
    ids = physics.render(96, 96, camera_id="c", segmentation=True)[..., 0]
    physics.free()
    for geom, pixel in enumerate(camera.project(centres)):
        rows, columns = np.nonzero(ids == geom)
        assert len(rows) > 20
        # Even a ball's picture is not quite centred on the projection of its centre.
        np.testing.assert_allclose([columns.mean() + 0.5, rows.mean() + 0.5], pixel, atol=0.2)
