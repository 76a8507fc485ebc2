"""Segmentation: from embeddings to masks, the loss, the scores, training and shipped weights."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch
from configs import real_config
from dm_control import mjcf

from sdfgcn.config import SegmentationConfig, SegmentationTrainingConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.objects.catalogue import load_catalogue
from sdfgcn.perception.segmenters.clustering import cluster, masks_of
from sdfgcn.perception.segmenters.ucn import UCNSegmenter, make_network, save_network
from sdfgcn.registry import SEGMENTERS
from sdfgcn.segmentation import dataset, training
from sdfgcn.segmentation.dataset import Pictures
from sdfgcn.segmentation.loss import clustering_loss
from sdfgcn.segmentation.metrics import match_masks, score_masks
from sdfgcn.segmentation.scores import Example, shifted_look, summary, views
from sdfgcn.segmentation.train import load_config, main
from sdfgcn.sim.arena import Table
from sdfgcn.sim.renderer import Renderer


def config_of(name: str = "ucn") -> SegmentationConfig:
    config = real_config("objects=household", f"segmentation={name}")
    return config.env.perception.segmentation


@pytest.fixture(scope="module")
def household() -> list[Example]:
    env = real_config("objects=household", "robot=gripper").env
    return list(views(env, load_catalogue(env.objects, "test"), [1, 4], 4))


@pytest.fixture(scope="module", params=sorted(SEGMENTERS))
def segmenter(request: pytest.FixtureRequest):
    return SEGMENTERS.find(request.param)(config_of(request.param))


# ---------------------------------------------------------------------- every segmenter


def test_masks_are_disjoint_large_enough_and_without_background(segmenter, household) -> None:
    for view in household:
        masks = segmenter(view.pixels)
        assert masks.dtype == bool
        assert masks.shape[1:] == view.pixels.shape[:2]
        assert masks.sum(axis=0).max(initial=0) <= 1
        assert (masks.sum(axis=(1, 2)) >= config_of().min_pixels).all()
        assert masks.any(axis=0).mean() < 0.5


def test_the_same_picture_gives_the_same_masks(segmenter, household) -> None:
    again = SEGMENTERS["ucn"](config_of())
    for view in household[:2]:
        np.testing.assert_array_equal(segmenter(view.pixels), again(view.pixels.copy()))


def test_an_empty_table_has_no_masks(segmenter) -> None:
    env = real_config("objects=household").env
    table = Table(arena=env.arena, physics=env.physics)
    physics = mjcf.Physics.from_mjcf_model(table.mjcf_model)
    pixels = Renderer(physics, env.arena.image_size).pixels()
    assert segmenter(pixels).shape == (0, *pixels.shape[:2])


def test_unseen_objects_are_found(segmenter, household) -> None:
    scores = summary([score_masks(segmenter(view.pixels), view.masks) for view in household])
    assert scores["overlap_f"] > 0.85
    assert scores["count_right"] > 0.7


# ---------------------------------------------------------------------- clustering and masks


def on_the_sphere(directions: np.ndarray, spread: float, n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = np.repeat(directions, n, axis=0) + spread * rng.normal(
        size=(n * len(directions), directions.shape[1])
    )
    return (points / np.linalg.norm(points, axis=1, keepdims=True)).astype(np.float32)


def test_mean_shift_separates_orthogonal_groups_and_puts_the_largest_first() -> None:
    points = on_the_sphere(np.eye(16)[:4], spread=0.03, n=50)
    points = np.vstack([points, on_the_sphere(np.eye(16)[4:5], spread=0.03, n=200)])
    labels = cluster(points, config_of())
    groups = [set(labels[50 * k : 50 * (k + 1)]) for k in range(4)] + [set(labels[200:])]
    assert all(len(group) == 1 for group in groups)
    assert len(set.union(*groups)) == 5
    assert groups[4] == {0}


def test_mean_shift_merges_modes_nearer_than_the_distance() -> None:
    # 20 and 60 degrees: cosine distances of 0.03 and 0.25, and the config merges below 0.1.
    for degrees, expected in ((20.0, 1), (60.0, 2)):
        angle = np.radians(degrees)
        pair = np.array([[1.0, 0.0, 0.0], [np.cos(angle), np.sin(angle), 0.0]])
        labels = cluster(on_the_sphere(pair, spread=0.001, n=20), config_of())
        assert len(set(labels)) == expected


def test_equal_embeddings_are_one_background() -> None:
    points = np.tile(np.eye(16, dtype=np.float32)[0], (100, 1))
    assert set(cluster(points, config_of())) == {0}


def test_masks_are_connected_parts_with_holes_filled_and_specks_dropped() -> None:
    labels = np.zeros((32, 32), dtype=np.int64)
    labels[2:8, 2:8] = 1
    labels[4:6, 4:6] = 0  # a hole of four pixels
    labels[20:25, 20:25] = 1  # the same cluster, elsewhere
    labels[10:13, 28:31] = 2  # nine pixels: a speck
    masks = masks_of(labels, config_of())
    assert [int(mask.sum()) for mask in masks] == [36, 25]
    assert masks[0, 2:8, 2:8].all()
    left_open = masks_of(labels, replace(config_of(), max_hole=3))
    assert int(left_open[0].sum()) == 32


def test_parts_of_a_cluster_stay_together_over_small_gaps() -> None:
    labels = np.zeros((32, 32), dtype=np.int64)
    labels[5:8, 2:8] = 1
    labels[5:8, 10:16] = 1  # two pixels away
    assert [int(mask.sum()) for mask in masks_of(labels, replace(config_of(), part_gap=2))] == [36]
    assert len(masks_of(labels, replace(config_of(), part_gap=0))) == 2
    labels[5:8, 10:16] = 0
    labels[5:8, 12:18] = 1  # four pixels away
    assert len(masks_of(labels, replace(config_of(), part_gap=2))) == 2


def test_a_hole_that_another_object_fills_stays_its_own() -> None:
    labels = np.zeros((32, 32), dtype=np.int64)
    labels[5:20, 5:20] = 1
    labels[8:16, 8:16] = 0
    labels[10:14, 10:14] = 2
    ring, inner = masks_of(labels, config_of())
    assert int(inner.sum()) == 16
    assert int(ring.sum()) == 15 * 15 - 16
    assert not (ring & inner).any()


# ---------------------------------------------------------------------- network and loss


def test_embeddings_have_length_one() -> None:
    config = config_of()
    network = make_network(config)
    embeddings = network(torch.rand(2, 3, 64, 32))
    assert embeddings.shape == (2, config.embedding, 64, 32)
    torch.testing.assert_close(embeddings.norm(dim=1), torch.ones(2, 64, 32))


def test_loss_of_a_hand_worked_case() -> None:
    # One picture of four pixels in the plane: the table twice at 0 degrees, an object at +-60
    # degrees around 90. The table's pixels are at their centre and not drawn. The object's are 60
    # degrees from theirs: (1 - 0.5) / 2 = 0.25, squared 0.0625. The centres are 90 degrees apart,
    # a distance of 0.5: with delta 0.7 they lack 0.2, squared 0.04.
    angles = torch.deg2rad(torch.tensor([0.0, 0.0, 30.0, 150.0]))
    embeddings = torch.stack([angles.cos(), angles.sin()]).reshape(1, 2, 2, 2)
    labels = torch.tensor([[[0, 0], [1, 1]]])
    pull, push = clustering_loss(embeddings, labels, pull=0.02, push=0.7, min_pixels=1)
    assert pull.item() == pytest.approx(0.0625, abs=1e-6)
    assert push.item() == pytest.approx(0.04, abs=1e-6)
    pull, push = clustering_loss(embeddings, labels, pull=0.3, push=0.5, min_pixels=1)
    assert pull.item() == pytest.approx(0.0, abs=1e-6)  # within the margin
    assert push.item() == pytest.approx(0.0, abs=1e-6)


def test_loss_leaves_out_small_clusters() -> None:
    embeddings = torch.nn.functional.normalize(torch.randn(1, 4, 4, 4), dim=1)
    labels = torch.zeros(1, 4, 4, dtype=torch.int64)
    labels[0, 0, 0] = 1
    alone = clustering_loss(embeddings, labels, 0.02, 0.5, min_pixels=2)
    assert alone[1].item() == 0.0  # no pair is left


# ---------------------------------------------------------------------- scores


def box(rows: slice, columns: slice) -> np.ndarray:
    mask = np.zeros((20, 20), dtype=bool)
    mask[rows, columns] = True
    return mask


def test_overlap_of_a_hand_worked_case() -> None:
    true = np.stack([box(slice(0, 4), slice(0, 4)), box(slice(10, 14), slice(10, 14))])
    found = np.stack([box(slice(10, 14), slice(10, 12)), box(slice(0, 4), slice(0, 6))])
    assert sorted(match_masks(found, true)) == [(0, 1), (1, 0)]
    scores = score_masks(found, true)
    assert scores.overlap.precision == pytest.approx((8 + 16) / (8 + 24))
    assert scores.overlap.recall == pytest.approx((8 + 16) / 32)
    assert scores.overlap.f == pytest.approx(2 * 0.75 * 0.75 / 1.5)


def test_boundary_forgives_one_pixel_but_not_three() -> None:
    true = box(slice(5, 15), slice(5, 15))[None]
    assert score_masks(true, true).boundary.f == 1.0
    assert score_masks(box(slice(6, 16), slice(5, 15))[None], true).boundary.f == 1.0
    # Moved by three rows, of 36 outline pixels these are within one of the true outline: 4 of the
    # first row (two at each end), 12 on the sides above the true last row and 2 just below it.
    far = score_masks(box(slice(8, 18), slice(5, 15))[None], true)
    assert far.boundary.precision == pytest.approx(18 / 36)


def test_scores_without_masks() -> None:
    none, one = np.zeros((0, 20, 20), dtype=bool), box(slice(0, 4), slice(0, 4))[None]
    assert score_masks(none, none).overlap.f == 1.0
    assert score_masks(none, one).overlap.f == 0.0
    assert score_masks(one, none).overlap.f == 0.0
    assert score_masks(one, none).boundary.f == 0.0


def test_views_follow_from_their_seeds(household) -> None:
    env = real_config("objects=household", "robot=gripper").env
    catalogue = load_catalogue(env.objects, "test")
    (again,) = views(env, catalogue, [1], 1)
    np.testing.assert_array_equal(again.pixels, household[0].pixels)
    (shifted,) = views(env, catalogue, [1], 1, shifted_look)
    np.testing.assert_array_equal(shifted.masks, household[0].masks)
    assert (shifted.pixels != household[0].pixels).mean() > 0.5


# ---------------------------------------------------------------------- weights


def test_weights_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    for content in (None, b"not weights", b""):
        file = tmp_path / "bad.safetensors"
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(SdfgcnError, match=r"weights .*bad\.safetensors cannot be read"):
            UCNSegmenter(replace(config_of(), weights=str(file)))


def test_weights_of_other_sizes_or_layers_are_named(tmp_path: Path) -> None:
    config, file = config_of(), tmp_path / "ucn.safetensors"
    save_network(make_network(config), config, file)
    UCNSegmenter(replace(config, weights=str(file)))
    with pytest.raises(SdfgcnError, match=r"embedding 16, but .* embedding 8"):
        UCNSegmenter(replace(config, weights=str(file), embedding=8))
    network = make_network(config)
    with torch.no_grad():
        next(network.parameters())[0] = torch.nan
    save_network(network, config, file)
    with pytest.raises(SdfgcnError, match=r"are damaged \('.*' is not finite\)"):
        UCNSegmenter(replace(config, weights=str(file)))
    safetensors.torch.save_file({"x": torch.zeros(1)}, file)
    with pytest.raises(SdfgcnError, match="unknown sizes"):
        UCNSegmenter(replace(config, weights=str(file)))


def test_a_picture_of_an_odd_size_is_refused(segmenter) -> None:
    with pytest.raises(SdfgcnError, match=r"image_size is 92, but .* multiple of 8"):
        segmenter(np.zeros((92, 92, 3), dtype=np.uint8))


# ---------------------------------------------------------------------- training


def training_config(*overrides: str) -> SegmentationTrainingConfig:
    shrunk = (
        "~objects@catalogues.scanned",
        "arrangements.layouts=2",
        "arrangements.appearances=2",
        "arrangements.workers=0",
        "steps=4",
        "batch=2",
        "checkpoint_steps=2",
        "validation_scenes=1",
        "n_objects=2",
    )
    return load_config(*shrunk, *overrides)


@pytest.fixture
def small_shards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataset, "SHARD", 2)
    monkeypatch.setattr(dataset, "pictures_folder", lambda config: tmp_path / "pictures")


@pytest.mark.usefixtures("small_shards")
def test_training_that_was_cut_off_goes_on_to_the_same_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = training_config()
    whole = training.train(config, tmp_path / "whole")
    update = training.Training._update

    def cut_off(interrupted, pictures):
        if interrupted.step == 3:
            raise KeyboardInterrupt
        return update(interrupted, pictures)

    with monkeypatch.context() as patch:
        patch.setattr(training.Training, "_update", cut_off)
        with pytest.raises(KeyboardInterrupt):
            training.train(config, tmp_path / "parts")
    assert not (tmp_path / "parts" / "ucn.safetensors").exists()
    parts = training.train(config, tmp_path / "parts")
    assert parts.read_bytes() == whole.read_bytes()
    rows = (tmp_path / "parts" / "metrics.csv").read_text().splitlines()
    assert [row.partition(",")[0] for row in rows] == ["step", "2", "4"]
    UCNSegmenter(replace(config_of(), weights=str(parts)))

    with pytest.raises(SdfgcnError, match=r"differs in seed \(0 there, 1 now\)"):
        training.train(training_config("seed=1"), tmp_path / "parts")
    (tmp_path / "parts" / "checkpoint.pt").write_bytes(b"half")
    with pytest.raises(SdfgcnError, match=r"checkpoint\.pt cannot be read"):
        training.train(config, tmp_path / "parts")


@pytest.mark.usefixtures("small_shards")
def test_training_pictures_are_labelled_and_a_damaged_shard_is_named(tmp_path: Path) -> None:
    config = training_config()
    pictures = dataset.load_pictures(config)
    assert pictures.pixels.shape == (4, 96, 96, 3)
    assert pictures.labels.shape == (4, 96, 96)
    assert all(0 < (labels > 0).mean() < 0.5 for labels in pictures.labels)
    assert not np.array_equal(pictures.pixels[0], pictures.pixels[1])  # the same objects
    file = next((tmp_path / "pictures").glob("*.npz"))
    file.write_bytes(file.read_bytes()[:500])
    with pytest.raises(SdfgcnError, match="are damaged"):
        dataset.load_pictures(config)
    for pixels, told in ((np.zeros((1, 2, 2, 3)), "of bytes"), (np.uint8([1]), "differ in shape")):
        np.savez(file, pixels=pixels, labels=np.zeros((1, 2, 2), dtype=np.uint8))
        with pytest.raises(SdfgcnError, match=rf"are damaged \(.*{told}"):
            dataset.load_pictures(config)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("steps=0", "steps is 0, but must lie between 1 and"),
        ("arrangements.n_objects=[3,2]", r"arrangements\.n_objects is \[3, 2\]"),
        ("~objects@catalogues.household", "catalogues is empty"),
    ],
)
def test_a_bad_training_config_is_a_sentence(override: str, message: str) -> None:
    with pytest.raises(SdfgcnError, match=message):
        training_config(override)


def test_help_shows_every_key_with_its_comment(capsys) -> None:
    assert main(["--help"]) == 0
    told = capsys.readouterr().out
    assert "KEY=VALUE" in told
    assert "learning_rate: 2.0e-3 # " in told
    assert "appearances: 5 # " in told


def test_a_loss_that_is_not_finite_names_the_update(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def endless(embedding, *rest):
        return embedding.sum() * torch.nan, embedding.sum()

    monkeypatch.setattr(training, "clustering_loss", endless)
    trained = training.Training(training_config(), tmp_path)
    trained.step = 7
    pictures = Pictures(np.zeros((2, 96, 96, 3), np.uint8), np.zeros((2, 96, 96), np.uint8))
    with pytest.raises(SdfgcnError, match=r"^In update 8, the loss is nan .* lower learning_rate"):
        trained._update(pictures)
