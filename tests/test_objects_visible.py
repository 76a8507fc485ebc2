"""Whether a picture from above shows an object: areas by hand, and the renderer's own view."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from configs import real_config
from odd_meshes import dome
from toys import IDENTITY, box_points, lay_out, toy

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.objects.model import ObjectModel
from sdfgcn.objects.visible import areas, made_visible, two_sided
from sdfgcn.sim.world import MujocoWorld

BLOCK = toy("block", box_points(0.06, 0.05, 0.04))


def open_bowl() -> ObjectModel:
    """A bowl without thickness, wound outwards, so that one looks into it on backs of faces."""
    vertices, faces = dome()
    vertices = 0.03 * vertices * [1.0, 1.0, -1.0] + [0.0, 0.0, 0.015]  # mirrored: on its back
    return replace(toy("bowl", vertices, IDENTITY), faces=faces[:, ::-1].astype(np.int32))


def test_areas_of_a_block_by_hand() -> None:
    seen = areas(BLOCK, BLOCK.rests[0])
    assert (seen.front, seen.both, seen.outline) == pytest.approx((0.003, 0.003, 0.003), rel=1e-4)


def test_a_block_without_its_top_has_no_front() -> None:
    corners = BLOCK.vertices[BLOCK.faces]
    top = (corners[:, :, 2] > 0).all(axis=1)
    bare = replace(BLOCK, faces=BLOCK.faces[~top])
    seen = areas(bare, bare.rests[0])
    assert seen.front == pytest.approx(0.0, abs=1e-9)
    assert seen.both == pytest.approx(0.003, rel=1e-4)


def test_what_can_be_seen_is_left_as_it_is() -> None:
    assert made_visible(BLOCK) is BLOCK


def test_household_objects_are_left_as_they_are() -> None:
    objects = real_config("objects=household").env.objects
    for model in load_catalogue(objects, "test"):
        assert made_visible(model) is model


def test_holes_are_refused_with_their_areas() -> None:
    """One of the two triangles of the top is left: half of 30 cm2, and a little less is refused."""
    top = (BLOCK.vertices[BLOCK.faces][:, :, 2] > 0).all(axis=1)
    half = replace(BLOCK, faces=BLOCK.faces[np.flatnonzero(top)[:1]])
    shrunk = replace(half, vertices=half.vertices * np.float32([0.9, 1.0, 1.0]))
    with pytest.raises(SdfgcnError, match=r"block cannot be .* 13\.50 of 30\.00 cm2"):
        made_visible(shrunk)
    made_visible(replace(half, vertices=half.vertices * np.float32([1.1, 1.0, 1.0])))


def test_what_is_too_narrow_is_refused() -> None:
    thread = toy("thread", box_points(0.12, 0.002, 0.01))
    with pytest.raises(SdfgcnError, match=r"thread cannot be .* outline has 2\.40 cm2"):
        made_visible(thread)


def test_the_renderer_shows_what_was_mended() -> None:
    """It culls backs of faces: a bad mesh shows less than its hull, a mended one as much."""
    bad = open_bowl()
    good, mended = toy("good", np.concatenate(bad.pieces)), made_visible(bad)
    assert len(mended.faces) == 2 * len(bad.faces)
    config = real_config("objects=household", "robot=gripper").env
    models = (good, bad, replace(mended, name="mended"))
    with closing(RearrangementEnv(config, world=MujocoWorld(config, models))) as env:
        pixels = []
        for index in range(len(models)):
            lay_out(env, [index], [(0.0, 0.05)])
            pixels.append(int(env.world.look().true_masks().sum()))
    assert pixels[2] == pytest.approx(pixels[0], rel=0.1)
    assert pixels[1] < 0.7 * pixels[2]


def test_texture_coordinates_follow_the_backs() -> None:
    uv = np.linspace(0.0, 1.0, 2 * len(BLOCK.vertices), dtype=np.float32).reshape(-1, 2)
    both = two_sided(replace(BLOCK, uv=uv))
    np.testing.assert_array_equal(both.uv, np.concatenate([uv, uv]))
    np.testing.assert_array_equal(
        both.vertices[both.faces[len(BLOCK.faces) :, ::-1]], both.vertices[BLOCK.faces]
    )
