"""The equivariant Q-network: what it sees, and that turns and mirrors only reorder its values."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from configs import real_config
from discs import discs, turned

from sdfgcn.errors import SdfgcnError
from sdfgcn.models import build_q_network
from sdfgcn.models.polar import reflected
from sdfgcn.models.polar_q import PolarQ

D, SIZE = 8, 96


def network(directions: int = D, **changes: Any) -> PolarQ:
    model = replace(real_config("model=polar_q").model, **changes)
    net = build_q_network(model, directions, 8, SIZE, 0)
    assert isinstance(net, PolarQ)
    return net


def test_what_an_object_sees_by_hand():
    """A disc at the origin, its goal 10 cm along x, another disc 12 cm along y, at its goal."""
    scene = discs((0.0, 0.05, 0.03), (0.0, 0.17, 0.02))
    goal = discs((0.10, 0.05, 0.03), (0.0, 0.17, 0.02))
    matched = torch.ones(1, 2, dtype=torch.bool)
    net = network()
    asked = torch.tensor([[True, False]])
    own, own_goal, others, other_goals, border, along = net.surroundings(
        scene, goal, matched, asked
    )[0]
    unit, radii = 0.25, torch.linspace(0.0, 0.21, 12)
    ring = 5  # 0.0955 m from the centre, on which column 0 is along x and column 8 along y
    assert float(own[ring, 3]) * unit == pytest.approx(float(radii[ring]) - 0.03, abs=0.003)
    assert float(own_goal[ring, 0]) * unit < -0.015  # inside the goal
    assert float(own_goal[ring, 16]) * unit == pytest.approx(
        0.10 + float(radii[ring]) - 0.03, abs=0.003
    )
    for other in (others, other_goals):
        assert float(other[ring, 8]) * unit == pytest.approx(
            0.12 - float(radii[ring]) - 0.02, abs=0.008
        )
    assert along[0] == pytest.approx(0.10 / unit * torch.cos(torch.arange(32) * math.pi / 16))
    region = real_config().env.arena
    nearest = min(0.05 - region.range_y[0], -region.range_x[0], region.range_x[1])
    assert float(border[0, 0]) * unit == pytest.approx(min(nearest, unit), abs=1e-6)


def test_a_goal_that_is_not_matched_is_not_seen():
    scene, goal = discs((0.0, 0.05, 0.03)), discs((0.10, 0.05, 0.03))
    seen = network().surroundings(
        scene, goal, torch.zeros(1, 1, dtype=torch.bool), torch.ones(1, 1, dtype=torch.bool)
    )[0]
    assert (seen[1] == 1.0).all() and (seen[5] == 0.0).all()


@pytest.mark.parametrize("directions", [4, 8])
def test_a_turn_of_the_maps_turns_the_pushes(directions):
    net = network(directions)
    around = torch.randn(3, 6, 12, 32)
    turned_by_one = net.values_around(around.roll(32 // directions, -1))
    assert (turned_by_one - net.values_around(around).roll(1, 1)).abs().max() < 1e-5


def test_a_mirror_image_mirrors_the_pushes():
    net, around = network(), torch.randn(3, 6, 12, 32)
    opposite = [(-k) % D for k in range(D)]
    there = net.values_around(reflected(around))
    assert (there[:, opposite] - net.values_around(around)).abs().max() < 1e-5


def test_values_turn_with_the_world():
    """Discs and goals in the middle of a wide table, turned by a direction: so do the values."""
    wide = replace(real_config().env.arena, range_x=[-2.0, 2.0], range_y=[-2.0, 2.0])
    net = network(arena=wide)
    middle = torch.tensor([0.0, 0.06])
    objects = torch.tensor([[0.0, 0.04], [0.09, 0.06]])
    goals = torch.tensor([[0.05, 0.12], [-0.05, 0.06]])
    matched = torch.ones(1, 2, dtype=torch.bool)
    values = []
    for angle in (0.0, math.pi / 4):
        scene, goal = (
            discs(
                *((*turned(place - middle, angle).add(middle).tolist(), 0.03) for place in places)
            )
            for places in (objects, goals)
        )
        values.append(net.action_values(scene, goal, matched))
    spread = values[0].std()
    # The picture has pixels of 9 mm, so that this is not exact.
    assert (values[1] - values[0].roll(1, dims=-1)).abs().max() < 0.1 * spread


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"strides": [1, 2]}, "model.strides is .*, but model.channels has 3 entries"),
        ({"strides": [2, 2, 2]}, "env.push.directions is 8, but must divide 4"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(changes, words):
    with pytest.raises(SdfgcnError, match=words):
        network(**changes)
