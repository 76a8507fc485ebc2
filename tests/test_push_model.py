"""The push model: what it sees, its symmetries, its planner's arithmetic, and that it learns."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from configs import real_config
from discs import discs, turned
from observations import random_observation
from tensordict import TensorDict
from torch import Tensor
from torchrl.data import Categorical

from sdfgcn.errors import SdfgcnError
from sdfgcn.models import build_q_network
from sdfgcn.models.planner import PlannerConfig, pushes_needed, risk_of_leaving
from sdfgcn.models.polar import PolarMaps, reflected
from sdfgcn.models.push_model import PushModel
from sdfgcn.task.scene import Scene
from sdfgcn.train.displacement import DisplacementLearner

D, SIZE = 8, 96
PLANNER = PlannerConfig(push=0.05, aim=0.03, away=1.0, noise=0.0, risk=10.0, depth=1, width=4)


def config() -> Any:
    return real_config("model=push_model")


def network(seed: int = 0, directions: int = D, **changes: Any) -> PushModel:
    model = replace(config().model, **changes)
    net = build_q_network(model, directions, 8, SIZE, seed)
    assert isinstance(net, PushModel)
    return net


# ------------------------------------------------------------------ polar maps


def test_maps_measure_metres_on_the_table():
    scene = discs((0.05, 0.10, 0.03), (0.15, 0.10, 0.02))
    net = network()
    points = net.maps.points(scene.center)
    fields = net.maps.distances(scene.sdf, points)
    radii = torch.linspace(0.0, 0.21, 12)
    # Around the disc itself: the distance to the centre, less the radius; but for the centre, where
    # the field has a tip that its pixels of 9 mm cut off.
    own = fields[0, 0, 0]
    assert (own - (radii[:, None] - 0.03))[1:].abs().max() < 0.002
    # Of the other disc, 0.10 m along x: at the centre, and at 0.076 m towards it and away from it.
    other = fields[0, 0, 1]
    ring = int((radii - 0.076).abs().argmin())
    assert float(other[0, 0]) == pytest.approx(0.08, abs=0.002)
    assert float(other[ring, 0]) == pytest.approx(0.08 - float(radii[ring]), abs=0.002)
    assert float(other[ring, 16]) == pytest.approx(0.08 + float(radii[ring]), abs=0.002)


def test_maps_of_shifted_objects_are_those_of_a_picture_after_the_shift():
    before = discs((0.0, 0.05, 0.03), (0.10, 0.05, 0.02))
    after = discs((0.04, 0.05, 0.03), (0.10, 0.12, 0.02))
    net = network()
    shift = after.center - before.center
    seen = net.maps.distances(after.sdf, net.maps.points(after.center))
    foretold = net.maps.distances(before.sdf, net.maps.points(after.center), shift)
    assert (seen - foretold)[..., 1:, :].abs().max() < 0.002


def test_the_border_is_the_nearest_side():
    arena = replace(config().env.arena, range_x=[-0.3, 0.3], range_y=[-0.1, 0.5])
    maps = PolarMaps(arena, 0.02, 4, 8, 0.1)
    points = torch.tensor([[0.0, 0.0], [0.25, 0.2], [0.4, 0.2], [0.0, 0.45]])
    assert maps.inside_by(points) == pytest.approx(torch.tensor([0.1, 0.05, -0.1, 0.05]))


# ------------------------------------------------------------------ symmetries


@pytest.mark.parametrize("directions", [4, 8, 16])
def test_a_turn_of_the_maps_turns_the_pushes(directions):
    net = network(directions=directions)
    around, asked = torch.randn(3, 3, 12, 32), torch.randn(5, 12, 32)
    ranks = torch.tensor([0, 0, 1, 2, 2])
    mean, deviation = net._displacements(around, asked, ranks)
    step = 32 // directions
    there, spread = net._displacements(around.roll(step, -1), asked.roll(step, -1), ranks)
    assert (there - mean.roll(1, 1)).abs().max() < 1e-5
    assert (spread - deviation.roll(1, 1)).abs().max() < 1e-5


def test_a_mirror_image_mirrors_the_pushes():
    net = network()
    around, asked = torch.randn(2, 3, 12, 32), torch.randn(2, 12, 32)
    ranks = torch.arange(2)
    mean, deviation = net._displacements(around, asked, ranks)
    there, spread = net._displacements(reflected(around), reflected(asked), ranks)
    opposite = [(-k) % D for k in range(D)]
    assert (there[:, opposite] * torch.tensor([1.0, -1.0]) - mean).abs().max() < 1e-5
    assert (spread[:, opposite] - deviation).abs().max() < 1e-5


def test_displacements_turn_with_the_world():
    """Discs in the middle of a wide table, turned by a direction: the displacements turn too."""
    wide = replace(config().model.arena, range_x=[-2.0, 2.0], range_y=[-2.0, 2.0])  # no border near
    net = network(arena=wide)
    net.eval()
    objects = torch.tensor([[0.0, 0.04], [0.09, 0.06], [-0.02, 0.16]])
    middle = torch.tensor([0.0, 0.06])
    later = turned(objects - middle, math.pi / 4) + middle
    moves = [
        net.moves(discs(*((float(x), float(y), 0.03) for x, y in places)))
        for places in (objects, later)
    ]
    expected = turned(moves[0].mean, math.pi / 4).roll(1, dims=-2)
    largest = moves[0].mean.norm(dim=-1).max()
    # The picture has pixels of 9 mm, so that this is not exact.
    assert (moves[1].mean - expected).norm(dim=-1).max() < 0.1 * largest


def test_what_is_far_away_changes_nothing():
    net = network()
    alone = net.moves(discs((-0.20, 0.0, 0.03)))
    far = net.moves(discs((-0.20, 0.0, 0.03), (0.25, 0.25, 0.03)))
    assert not far.near[0, 0, 1] and not far.near[0, 1, 0]
    assert (alone.mean[0, 0, 0] - far.mean[0, 0, 0]).abs().max() < 1e-6
    assert (far.mean[0, 0, 1] == 0.0).all()


def test_rows_are_a_part_of_all():
    net = network()
    td = random_observation(3, 5, (2,), size=SIZE)
    td["scene"].node_mask[:] = True
    whole = net.moves(td["scene"])
    rows = torch.tensor([[2], [4]])
    some = net.moves(td["scene"], rows)
    for b, row in enumerate(rows[:, 0]):
        assert torch.equal(some.near[b, 0], whole.near[b, row])
        assert (some.mean[b, 0] - whole.mean[b, row]).abs().max() < 1e-6


def test_directions_between_the_angles_are_refused():
    with pytest.raises(SdfgcnError, match=r"env.push.directions is 6, but must divide"):
        network(directions=6)


# ------------------------------------------------------------------ the planner


def test_pushes_needed_by_hand():
    distance = torch.tensor([0.0, 0.04, 0.06, 0.13])
    known = pushes_needed(PLANNER, 0.05, distance, torch.zeros(4))
    assert known == pytest.approx(torch.tensor([0.0, 0.2, 1.6, 3.0]))
    # Where nothing is known but that the threshold is as likely passed as not:
    unsure = pushes_needed(PLANNER, 0.05, torch.tensor([0.05]), torch.tensor([0.02]))
    assert float(unsure) == pytest.approx(0.4 + 0.5)
    # One standard deviation inside the threshold: a chance of 15.9% that it is not there.
    noisy = replace(PLANNER, noise=0.01)
    seems = pushes_needed(noisy, 0.05, torch.tensor([0.04]), torch.zeros(1))
    assert float(seems) == pytest.approx(0.2 + 0.1587, abs=1e-4)


def test_risk_by_hand():
    # One and two standard deviations inside: 15.9% and 2.3%; on the border a half.
    inside = torch.tensor([0.02, 0.04, 0.0, -0.04])
    risk = risk_of_leaving(inside, torch.full((4,), 0.02))
    assert risk == pytest.approx(torch.tensor([0.1587, 0.0228, 0.5, 0.9772]), abs=1e-4)


class Straight(PushModel):
    """Every push moves its object by 5 cm, and nothing else."""

    def moves(
        self, scene: Scene, rows: Tensor | None = None, mirrored: bool = True, shift: Any = None
    ) -> Any:
        moves = super().moves(scene, rows, mirrored, shift)
        n = moves.near.shape[-1]
        own = torch.eye(n, dtype=torch.bool)[None, :, :, None]
        ahead = self.frames[:, :, 0] * 0.05
        mean = torch.where(own[..., None], ahead, torch.zeros(2)).expand_as(moves.mean)
        return moves._replace(mean=mean, deviation=torch.full_like(moves.deviation, 1e-4))


def straight(depth: int) -> Straight:
    model = config().model
    model = replace(model, planner=replace(PLANNER, depth=depth, width=16))
    return Straight(model, D, 2, SIZE)


def test_the_planner_pushes_towards_the_goal():
    """One object 15 cm from its goal along x: a push nearer saves one of the pushes needed."""
    scene, goal = discs((-0.05, 0.05, 0.03)), discs((0.10, 0.05, 0.03))
    values = straight(1).action_values(scene, goal, torch.ones(1, 1, dtype=torch.bool))[0, 0]
    assert int(values.argmax()) == 0  # heading 0 is along x
    assert float(values[0]) == pytest.approx(1.0, abs=1e-3)
    assert float(values[4]) == pytest.approx(-1.0, abs=1e-3)


def test_two_pushes_are_seen_ahead():
    """12 cm from the goal: two pushes of 5 cm bring it there, and save all that is needed."""
    scene, goal = discs((-0.05, 0.05, 0.03)), discs((0.07, 0.05, 0.03))
    matched = torch.ones(1, 1, dtype=torch.bool)
    first = straight(1).action_values(scene, goal, matched)[0, 0]
    both = straight(2).action_values(scene, goal, matched)[0, 0]
    needed = (0.12 - 0.03) / 0.05 + 1.0
    assert float(first[0]) == pytest.approx(1.0, abs=1e-3)
    assert float(both[0]) == pytest.approx(needed, abs=1e-3)


def test_the_planner_shuns_the_border():
    """An object 3 cm inside the border is not pushed out, whatever that saves."""
    right = config().env.arena.range_x[1]
    scene, goal = discs((right - 0.03, 0.05, 0.02)), discs((right + 0.10, 0.05, 0.02))
    values = straight(1).action_values(scene, goal, torch.ones(1, 1, dtype=torch.bool))[0, 0]
    assert float(values[0]) == pytest.approx(1.0 - 10.0, abs=1e-3)


@pytest.mark.parametrize("depth", [1, 2])
def test_the_explanation_adds_up(depth):
    """What it says it weighed makes the values that it acts on."""
    scene = discs((-0.05, 0.05, 0.03), (0.10, 0.20, 0.03), rows=3)
    goal = discs((0.10, 0.05, 0.03), (-0.10, 0.20, 0.03), rows=3)
    matched = scene.node_mask
    net = straight(depth)
    row, direction = 1, 4
    action = torch.tensor(row * D + direction)
    td = TensorDict(scene=scene[0], goal=goal[0], matched=matched[0], action=action)
    told = net.explain(td)
    scores = told.scores
    value = scores["pushes saved"] - PLANNER.risk * scores["out of range"]
    if depth == 2:
        later = scores["saved by the next"]
        assert np.isfinite(later).sum() == 16  # the planner's width
        assert not np.isfinite(later[2]).any()  # no object, no push
        value = value + np.nan_to_num(later)
    expected = net.action_values(scene, goal, matched)[0].numpy()
    np.testing.assert_allclose(value[:2], expected[:2], atol=1e-4)
    # This network says that a push moves its object by 5 cm and nothing else.
    np.testing.assert_allclose(told.displacement, [[0, 0], [-0.05, 0], [0, 0]], atol=1e-6)
    np.testing.assert_allclose(told.deviation, 1e-4)


# ------------------------------------------------------------------ learning


def test_it_learns_where_pushes_lead():
    """Discs that move 4 cm ahead, and their neighbours not at all."""
    generator = torch.Generator().manual_seed(0)
    learner = DisplacementLearner(
        network(), Categorical(2 * D), replace(config().train, learning_rate=3e-3), "cpu"
    )
    figures = {}
    for _ in range(40):
        places = torch.rand(8, 2, generator=generator) * 0.2 - 0.1
        scenes = torch.cat(
            [
                discs((float(x), float(y), 0.03), (float(x) + 0.09, float(y), 0.03))
                for x, y in places
            ]
        )
        action = torch.randint(2 * D, (8,), generator=generator)
        angle = (action % D) * (2.0 * math.pi / D)
        moved = 0.04 * torch.stack([angle.cos(), angle.sin()], dim=-1)
        after = scenes.clone()
        after.position[torch.arange(8), action // D] += moved
        matched = torch.ones(8, 2, dtype=torch.bool)
        batch = TensorDict(
            {
                "scene": scenes,
                "action": action,
                "matched": matched,
                "next": {"scene": after, "matched": matched},
            },
            [8],
        )
        figures = learner.update(batch)
    assert figures["moved_mm"] == pytest.approx(40.0, abs=0.1)
    assert figures["error_mm"] < 10.0
    assert figures["explained"] > 0.9


def test_a_batch_in_which_nothing_is_known_teaches_nothing():
    learner = DisplacementLearner(network(), Categorical(2 * D), config().train, "cpu")
    before = [weights.detach().clone() for weights in learner.network.parameters()]
    scenes, unmatched = discs((0.0, 0.0, 0.03)), torch.zeros(1, 1, dtype=torch.bool)
    after = {"scene": scenes.clone(), "matched": unmatched}
    seen = {"scene": scenes, "action": torch.tensor([0]), "matched": unmatched, "next": after}
    assert learner.update(TensorDict(seen, [1]))["loss"] == 0.0
    after_it = list(learner.network.parameters())
    assert all(torch.equal(a, b) for a, b in zip(before, after_it, strict=True))
