"""A scene in which an object is hidden from the start is drawn anew; every other one stays."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
from conftest import Envs

from sdfgcn.sim import world as module
from sdfgcn.sim.episode import EpisodeSpec, draw_episode
from sdfgcn.sim.world import MujocoWorld

SEED, N = 3, 3
OUTSIDE = 3.0  # m, beyond the picture


@pytest.fixture
def world(toys_of: Envs) -> MujocoWorld:
    return toys_of("gripper").world


def drawn(world: MujocoWorld, redraw: int) -> EpisodeSpec:
    return draw_episode(SEED, world.catalogue, replace(world._config, n_objects=N), redraw)


def hide_until(monkeypatch: pytest.MonkeyPatch, first: int) -> None:
    """Put slot 1 outside the picture in all draws of a seed before number `first`."""

    def draw(seed, catalogue, config, redraw=0):
        episode = draw_episode(seed, catalogue, config, redraw)
        if redraw < first:
            episode.start[1, 0] = OUTSIDE
        return episode

    monkeypatch.setattr(module, "draw_episode", draw)


def test_a_scene_that_shows_everything_is_the_first_drawn(world, caplog) -> None:
    with caplog.at_level(logging.INFO):
        world.reset(SEED, N)
    np.testing.assert_array_equal(world.task.episode.start, drawn(world, 0).start)
    assert not caplog.records


def test_a_hidden_object_is_named_and_the_scene_drawn_anew(world, monkeypatch, caplog) -> None:
    hide_until(monkeypatch, 2)
    with caplog.at_level(logging.INFO):
        world.reset(SEED, N)
    np.testing.assert_array_equal(world.task.episode.start, drawn(world, 2).start)
    assert world.look().true_masks().any(axis=(1, 2)).all()
    assert world.task.episode.seed == SEED
    hidden = [world.catalogue[drawn(world, redraw).objects[1]].name for redraw in (0, 1)]
    assert [record.getMessage() for record in caplog.records] == [
        f"The scene of seed {SEED} is drawn anew: no pixel shows {name}." for name in hidden
    ]


def test_redraws_differ_and_depend_on_the_seed_alone(world) -> None:
    first, second = drawn(world, 1), drawn(world, 2)
    assert not np.array_equal(first.start, drawn(world, 0).start)
    assert not np.array_equal(first.start, second.start)
    np.testing.assert_array_equal(second.goal, drawn(world, 2).goal)


def test_where_every_scene_hides_something_the_first_is_taken(world, monkeypatch, caplog) -> None:
    hide_until(monkeypatch, 1000)
    monkeypatch.setattr(module, "MAX_REDRAWS", 2)
    world.reset(SEED, N)
    assert world.task.episode.start[1, 0] == OUTSIDE
    np.testing.assert_array_equal(world.task.episode.goal, drawn(world, 0).goal)
    assert "taken as first drawn" in caplog.records[-1].getMessage()
    assert len(caplog.records) == 4
