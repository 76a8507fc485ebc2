"""What every scenario promises, and what each one is for."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from configs import real_config
from scipy.spatial.transform import Rotation
from shapely import MultiPoint, Point, box
from shapely.affinity import translate

from sdfgcn.config import EnvConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.objects.model import ObjectModel
from sdfgcn.registry import SCENARIOS
from sdfgcn.sim.episode import EpisodeSpec, draw_episode
from sdfgcn.sim.placement import NoRoom
from sdfgcn.sim.scenarios.packed import Packed
from sdfgcn.sim.scenarios.scenario import Situation
from sdfgcn.sim.scenarios.swap import Swap

SEEDS = range(4)
COUNTS = [(name, n) for name, kind in SCENARIOS.items() for n in range(kind.least_objects, 7)]


@pytest.fixture(scope="module")
def catalogue() -> tuple[ObjectModel, ...]:
    return load_catalogue(real_config("objects=household").env.objects, "test")


def config(scenario: str, n: int) -> EnvConfig:
    """With outlines that keep 1 cm apart."""
    env = real_config("objects=household", f"scenario={scenario}", "env.scenario.gap=0.01").env
    return replace(env, n_objects=n)


@pytest.fixture(scope="module")
def draws(catalogue) -> Callable[[str, int], list[EpisodeSpec]]:
    """Episodes of a scenario with n objects; drawn once for all tests."""

    @cache
    def draw(scenario: str, n: int) -> list[EpisodeSpec]:
        return [draw_episode(seed, catalogue, config(scenario, n)) for seed in SEEDS]

    return draw


def yaws(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    """[n] angle about the vertical from one pose to the other, radians; it must be all."""
    turns = Rotation.from_quat(others[:, 3:], scalar_first=True) * (
        Rotation.from_quat(poses[:, 3:], scalar_first=True).inv()
    )
    vectors = turns.as_rotvec()
    np.testing.assert_allclose(vectors[:, :2], 0.0, atol=1e-9)
    return vectors[:, 2]


# ------------------------------------------------------------------ all scenarios


@pytest.mark.parametrize(("scenario", "n"), COUNTS)
def test_layouts_keep_region_and_spacing(catalogue, draws, scenario, n):
    for episode in draws(scenario, n):
        models = [catalogue[i] for i in episode.objects]
        assert len(set(episode.objects)) == n
        for poses in (episode.start, episode.goal):
            assert poses.shape == (n, 7)
            x, y = poses[:, :2].T
            assert (np.abs(x) <= 0.25).all()
            assert ((y >= -0.12) & (y <= 0.30)).all()
            outlines = []
            for model, pose in zip(models, poses, strict=True):
                turned = Rotation.from_quat(pose[3:], scalar_first=True).apply(model.vertices)
                outlines.append(translate(MultiPoint(turned[:, :2]).convex_hull, *pose[:2]))
            for i, j in itertools.combinations(range(n), 2):
                apart = config(scenario, n).scenario.spacing
                assert np.hypot(*(poses[i] - poses[j])[:2]) >= apart - 1e-6
                assert outlines[i].distance(outlines[j]) >= 0.01 - 1e-6


@pytest.mark.parametrize(("scenario", "n"), COUNTS)
def test_objects_rest_colours_differ_and_yaw_changes(catalogue, draws, scenario, n):
    turned = []
    for episode in draws(scenario, n):
        palette = np.array(real_config("objects=household").env.objects.palette)
        assert len(np.unique(episode.colors, axis=0)) == n
        for color in episode.colors:
            assert (np.abs(palette - color[:3]).max(axis=1) < 1e-9).any() and color[3] == 1.0
        for i, start, goal in zip(episode.objects, episode.start, episode.goal, strict=True):
            rest = np.array([rest.quat for rest in catalogue[i].rests])
            heights = np.array([rest.height for rest in catalogue[i].rests])
            # Which way is down, seen from the object, does not depend on yaw.
            down, start_down, goal_down = (
                Rotation.from_quat(q, scalar_first=True).inv().apply([0.0, 0.0, -1.0])
                for q in (rest, start[3:], goal[3:])
            )
            fits = np.linalg.norm(down - start_down, axis=1) < 1e-6
            assert (fits & (heights == start[2])).any()
            np.testing.assert_allclose(start_down, goal_down, atol=1e-6)
            assert start[2] == goal[2]
        turned.append(np.abs(yaws(episode.start, episode.goal)))
    if SCENARIOS[scenario].same_yaw:
        assert np.max(turned) < 1e-9
    else:
        assert np.min(turned) > 1e-3 and np.max(turned) > 0.5


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_episode_follows_from_its_seed(catalogue, scenario):
    first, again, other = (draw_episode(seed, catalogue, config(scenario, 4)) for seed in (5, 5, 6))
    for name in ("objects", "start", "goal", "colors"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert (first.start != other.start).any()
    assert first.seed == 5


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_impossible_layout_is_a_sentence(catalogue, scenario):
    env = config(scenario, 3)
    crowded = replace(env, scenario=replace(env.scenario, spacing=2.0))
    with pytest.raises(
        SdfgcnError, match=rf"No {scenario} layout of 3 objects.*now 2\.0 m"
    ) as info:
        draw_episode(0, catalogue, crowded)
    assert "\n" not in str(info.value)


@pytest.mark.parametrize("scenario", [k for k, v in SCENARIOS.items() if v.least_objects > 1])
def test_too_few_objects_is_a_sentence(catalogue, scenario):
    least = SCENARIOS[scenario].least_objects
    with pytest.raises(
        SdfgcnError,
        match=rf"^scenario={scenario} needs at least {least} objects, but n_objects is {least - 1}",
    ):
        draw_episode(0, catalogue, config(scenario, least - 1))


def test_too_small_a_catalogue_is_a_sentence(catalogue):
    with pytest.raises(SdfgcnError, match=r"n_objects is 4, but objects=household has only 3"):
        draw_episode(0, catalogue[:3], config("random", 4))


def test_rests_are_drawn_by_their_probability(catalogue):
    # 400 draws of one object: each share within 3.5 standard deviations.
    model = catalogue[4]
    count = np.zeros(len(model.rests))
    for seed in range(400):
        episode = draw_episode(seed, (model,), config("random", 1))
        count[[rest.height for rest in model.rests].index(episode.start[0, 2])] += 1
    share = np.array([rest.probability for rest in model.rests])
    assert len(share) == 2
    assert np.abs(count / 400 - share).max() < 3.5 * np.sqrt(share[0] * share[1] / 400)


# ------------------------------------------------------------------ each scenario


def test_packed_objects_are_close(catalogue, draws):
    """Nearest neighbours lie within 15 cm, centre to centre; drawn uniformly, they seldom do."""
    nearest = {}
    for scenario in ("packed", "random"):
        gaps = []
        for episode in draws(scenario, 6):
            for poses in (episode.start, episode.goal):
                apart = np.linalg.norm(poses[:, None, :2] - poses[None, :, :2], axis=-1)
                gaps.append((apart + np.eye(6)).min(axis=1))
        nearest[scenario] = np.concatenate(gaps)
    assert nearest["packed"].max() < 0.15
    assert nearest["packed"].mean() < 0.8 * nearest["random"].mean()


def test_packed_takes_the_nearest_free_place():
    """Discs of 2 cm radius, 5 mm apart: seven fit into a hexagon of 45 mm around the first."""
    disc = Point(0.0, 0.0).buffer(0.02)
    env = replace(config("packed", 6), scenario=real_config("scenario=packed").env.scenario)
    env = replace(env, scenario=replace(env.scenario, spacing=0.0, max_tries=20_000))
    shapes = (disc,) * 7
    situation = Situation(start=shapes, goal=shapes, categories=("any",) * 7)
    layout = Packed(env.scenario, env.arena).draw(np.random.default_rng(1), situation)
    for points in (layout.start, layout.goal):
        spread = np.linalg.norm(points - points[0], axis=1)
        assert 0.0445 < spread[1] < 0.05  # a disc is a polygon here
        assert spread.max() < 0.10


@pytest.mark.parametrize("n", range(2, 7))
def test_swap_exchanges_exactly_two(draws, n):
    pairs = set()
    for episode in draws("swap", n):
        start, goal = episode.start[:, :2], episode.goal[:, :2]
        moved = np.flatnonzero((start != goal).any(axis=1))
        assert len(moved) == 2
        np.testing.assert_array_equal(goal[moved], start[moved[::-1]])
        np.testing.assert_array_equal(episode.goal[:, 3:], episode.start[:, 3:])
        pairs.add(tuple(moved))
    assert n == 2 or len(pairs) > 1


def test_swap_gives_up_where_the_larger_one_does_not_fit():
    """A plate of 20 cm takes the place of a cube of 4 cm, between two others."""
    plate, cube = box(-0.1, -0.1, 0.1, 0.1), box(-0.02, -0.02, 0.02, 0.02)
    shapes, env = (plate, cube, cube, cube), config("swap", 4)
    situation = Situation(start=shapes, goal=shapes, categories=("any",) * 4)
    refused = 0
    for seed in range(40):
        try:
            layout = Swap(env.scenario, env.arena).draw(np.random.default_rng(seed), situation)
        except NoRoom:
            refused += 1
            continue
        for points in (layout.start, layout.goal):
            placed = [translate(shape, *xy) for shape, xy in zip(shapes, points, strict=True)]
            for one, other in itertools.combinations(placed, 2):
                assert one.distance(other) >= 0.01 - 1e-9
    assert 0 < refused < 40


@pytest.mark.parametrize("n", range(3, 7))
def test_line_is_straight_and_close(catalogue, draws, n):
    orders = set()
    for episode in draws("line", n):
        goal = episode.goal[:, :2]
        _, spread, axes = np.linalg.svd(goal - goal.mean(axis=0))
        assert spread[1] < 1e-9
        along = goal @ axes[0]
        order = np.argsort(along)
        orders.add(tuple(order))
        # Neighbours stand as near as both rules allow: 10 cm or their circles plus 1 cm.
        radii = []
        for i, pose in zip(episode.objects, episode.goal, strict=True):
            turned = Rotation.from_quat(pose[3:], scalar_first=True).apply(catalogue[i].vertices)
            radii.append(np.linalg.norm(turned[:, :2], axis=1).max())
        radii = np.array(radii)[order]
        wanted = np.maximum(0.10, radii[1:] + radii[:-1] + 0.01)
        np.testing.assert_allclose(np.diff(along[order]), wanted, atol=1e-6)
    assert len(orders) > 1


@pytest.mark.parametrize("n", range(2, 7))
def test_circle_is_even(draws, n):
    for episode in draws("circle", n):
        goal = episode.goal[:, :2]
        spokes = goal - goal.mean(axis=0)  # an even ring's centre is its mean
        radius = np.linalg.norm(spokes, axis=1)
        np.testing.assert_allclose(radius, radius[0], atol=1e-9)
        angles = np.sort(np.arctan2(spokes[:, 1], spokes[:, 0]))
        gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
        np.testing.assert_allclose(gaps, 2 * np.pi / n, atol=1e-9)


@pytest.mark.parametrize("n", range(2, 7))
def test_sort_separates_the_categories(catalogue, draws, n):
    sizes = set()
    for episode in draws("sort", n):
        names = np.array([catalogue[i].category for i in episode.objects])
        # Left to right, no category comes back once another has begun.
        groups = [name for name, _ in itertools.groupby(names[np.argsort(episode.goal[:, 0])])]
        assert len(groups) == len(set(groups)) >= 2
        sizes.update(np.unique(names, return_counts=True)[1])
    assert n < 4 or max(sizes) > 1


def test_random_goal_is_no_copy_of_the_start(draws):
    for episode in draws("random", 3):
        distances = np.linalg.norm((episode.start - episode.goal)[:, :2], axis=1)
        assert (distances > 1e-3).all()


def test_goal_radii_reach_the_furthest_corner():
    shapes = (MultiPoint([(0.03, 0.04), (-0.01, 0.0), (0.0, -0.02)]).convex_hull,)
    situation = Situation(start=shapes, goal=shapes, categories=("any",))
    np.testing.assert_allclose(situation.goal_radii, [0.05])
    assert Point(0, 0).hausdorff_distance(shapes[0]) == pytest.approx(0.05)
