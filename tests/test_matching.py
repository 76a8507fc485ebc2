"""Matching: encoders, features of masked patches, assignment."""

import io
import math
import os
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch
from configs import real_config
from safetensors.torch import save_file

from sdfgcn.config import EncoderConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.perception.encoders.encoder import pool
from sdfgcn.perception.encoders.resnet import DEPTHS, TorchvisionResNet
from sdfgcn.perception.matching import Matcher
from sdfgcn.registry import ENCODERS
from sdfgcn.sim.episode import draw_episode
from sdfgcn.sim.world import MujocoWorld

SIZE = 96


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A file of random weights of a ResNet-18, under torchvision's names."""
    path = tmp_path_factory.mktemp("weights") / "resnet18.pth"
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        torch.save(TorchvisionResNet(18).state_dict(), path)
    return path


@pytest.fixture(scope="module", params=sorted(ENCODERS))
def config(request, weights) -> EncoderConfig:
    config = real_config(f"encoder={request.param}").env.perception.encoder
    if request.param == "resnet":
        return replace(config, path=str(weights), depth=18)
    return config


@pytest.fixture(scope="module")
def matcher(config) -> Matcher:
    return Matcher(config)


@pytest.fixture(scope="module")
def resnet(weights) -> EncoderConfig:
    config = real_config("encoder=resnet").env.perception.encoder
    return replace(config, path=str(weights), depth=18)


def block(rows: tuple[int, int], columns: tuple[int, int]) -> np.ndarray:
    mask = np.zeros((SIZE, SIZE), bool)
    mask[slice(*rows), slice(*columns)] = True
    return mask


def picture(masks: np.ndarray, colors: list[tuple[int, int, int]]) -> np.ndarray:
    pixels = np.full((SIZE, SIZE, 3), 120, np.uint8)
    for mask, color in zip(masks, colors, strict=True):
        pixels[mask] = color
    return pixels


# A square, a bar and a longer bar; the first two of one colour.
MASKS = np.stack([block((10, 20), (10, 20)), block((40, 45), (50, 70)), block((70, 78), (20, 44))])
PIXELS = picture(MASKS, [(200, 40, 40), (200, 40, 40), (40, 40, 200)])


# ------------------------------------------------------------------ features


def test_features_are_one_row_an_object(matcher):
    rows = matcher.features(PIXELS, MASKS)
    assert rows.dtype == np.float32
    assert rows.shape == (3, matcher.n_features)
    assert np.isfinite(rows).all()
    assert matcher.features(PIXELS, MASKS[:0]).shape == (0, matcher.n_features)


def test_each_stage_counts_one_and_the_mean_colour_its_weight(matcher, config):
    rows = matcher.features(PIXELS, MASKS)
    stages = (rows[:, :-3] ** 2).sum(axis=1)
    np.testing.assert_allclose(stages, len(config.stages), rtol=1e-5)
    expected = config.color_weight * np.array([[200, 40, 40], [200, 40, 40], [40, 40, 200]]) / 255
    np.testing.assert_allclose(rows[:, -3:], expected, atol=1e-6)


def test_features_do_not_depend_on_the_place_or_on_what_is_around(matcher):
    moved = np.roll(MASKS[1], (-20, 17), axis=(0, 1))
    pixels = np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8)
    pixels[moved] = PIXELS[MASKS[1]][0]
    np.testing.assert_array_equal(
        matcher.features(pixels, moved[None]), matcher.features(PIXELS, MASKS[1:2])
    )


def test_size_shape_and_colour_each_tell_objects_apart(matcher):
    small, large = block((40, 48), (40, 48)), block((40, 52), (40, 52))
    bar = block((42, 46), (36, 52))  # as many pixels as the small square
    red, blue = (200, 40, 40), (40, 40, 200)

    def row(mask, color):
        return matcher.features(picture(mask[None], [color]), mask[None])[0]

    reference = row(small, red)
    for other in (row(large, red), row(bar, red), row(small, blue)):
        assert np.linalg.norm(other - reference) > 0.01


def test_a_turned_object_is_nearer_to_itself_than_without_turns():
    config = real_config().env.perception.encoder
    # Seen straight from above a quarter turn is exact: only the network's view of it changes.
    upright, lying = block((38, 58), (45, 51)), block((45, 51), (38, 58))
    distance = {}
    for turns in (1, 5):
        matcher = Matcher(replace(config, rotations=turns, camera_tilt=0.0))
        rows = [
            matcher.features(picture(m[None], [(90, 160, 60)]), m[None]) for m in (upright, lying)
        ]
        distance[turns] = np.linalg.norm(rows[0] - rows[1])
    assert distance[5] < 0.25 * distance[1]


def test_the_table_is_stretched_back_before_turning():
    # Seen from 60 degrees, a disc on the table is half as high as it is wide: turns do not
    # change what the network sees of it, once that is undone.
    v, u = np.mgrid[:SIZE, :SIZE] + 0.5
    disc = np.hypot(u - 48.0, (v - 48.0) / 0.5) < 36.0
    config = replace(real_config().env.perception.encoder, rotations=4)
    changed = {}
    for tilt in (0.0, 60.0):
        matcher = Matcher(replace(config, camera_tilt=tilt))
        _, masks = matcher._turned(np.ones((SIZE, SIZE, 3), np.float32), disc, 96.0)
        changed[tilt] = float((masks[0] - masks[1]).abs().mean())
    assert changed[60.0] < 0.1 * changed[0.0]


def test_an_empty_mask_is_zero_and_a_full_one_finite(matcher):
    empty, full = np.zeros((SIZE, SIZE), bool), np.ones((SIZE, SIZE), bool)
    rows = matcher.features(PIXELS, np.stack([empty, full]))
    assert not rows[0].any()
    assert np.isfinite(rows[1]).all()


def test_pooling_is_over_the_object_alone():
    maps = torch.tensor([[[[1.0, 3.0], [100.0, -7.0]]]])
    mask = torch.tensor([[[[1.0, 1.0], [0.0, 0.0]]]])
    # Mean 2 and deviation 1, but for the little weight that every cell has.
    np.testing.assert_allclose(pool(maps, mask), [[2.0, 1.0]], rtol=0.4)
    twice = pool(maps, mask.repeat_interleave(8, dim=2).repeat_interleave(8, dim=3))
    np.testing.assert_allclose(twice, pool(maps, mask))


def test_nothing_is_drawn_from_torchs_generator(config):
    before = torch.get_rng_state()
    Matcher(config).features(PIXELS, MASKS)
    assert torch.equal(torch.get_rng_state(), before)


# ------------------------------------------------------------------ what is remembered


def test_unchanged_objects_are_not_encoded_again(config, monkeypatch):
    matcher = Matcher(config)
    encoded = []
    forward = type(matcher._encoder).forward
    monkeypatch.setattr(
        type(matcher._encoder), "forward", lambda *given: encoded.append(1) or forward(*given)
    )
    first = matcher.features(PIXELS, MASKS)
    assert len(encoded) == 3
    np.testing.assert_array_equal(matcher.features(PIXELS.copy(), MASKS.copy()), first)
    assert len(encoded) == 3
    # One object turns; one pixel of another changes.
    masks, pixels = MASKS.copy(), PIXELS.copy()
    masks[1] = block((40, 60), (50, 55))
    pixels[masks[1]] = (200, 40, 40)
    matcher.features(pixels, masks)
    assert len(encoded) == 4
    pixels[12, 12] += 1
    matcher.features(pixels, masks)
    assert len(encoded) == 5
    # The same bits in a box of another shape are another object.
    flat = np.stack([block((5, 7), (5, 13)), block((5, 13), (5, 7))])
    rows = matcher.features(picture(flat, [(9, 9, 9)] * 2), flat)
    assert len(encoded) == 7
    assert not np.array_equal(*rows)


def test_features_are_the_same_alone_in_company_and_in_another_matcher(matcher, config):
    together = matcher.features(PIXELS, MASKS)
    other = Matcher(config)
    alone = np.concatenate([other.features(PIXELS, MASKS[i : i + 1]) for i in (2, 0, 1)])
    np.testing.assert_array_equal(alone, together[[2, 0, 1]])


# ------------------------------------------------------------------ assignment


@pytest.fixture(scope="module")
def assign():
    """`match` alone, on features of one number."""

    def run(current, goal):
        found = Matcher.match(None, np.float32(current)[:, None], np.float32(goal)[:, None])
        assert found.dtype == np.int64
        return found.tolist()

    return run


@pytest.mark.parametrize(
    ("current", "goal", "expected"),
    [
        ([0, 10], [11, 1], [1, 0]),
        # Greedily 4 would take 5 (distance 1), leaving 0 for 9: 9 + 1. Together: 4 + ... = 8.
        ([4, 6], [5, 0], [1, 0]),
        # Fewer current objects than goals: the third goal is left.
        ([9, 1], [0, 4, 10], [2, 0]),
        # More: 5 is furthest from both goals.
        ([9, 5, 1], [0, 10], [1, -1, 0]),
        ([3], [7], [0]),
        ([], [1, 2], []),
        ([1, 2], [], [-1, -1]),
        ([], [], []),
    ],
)
def test_least_total_distance(assign, current, goal, expected):
    assert assign(current, goal) == expected


def test_permuted_objects_are_found(matcher):
    rows = matcher.features(PIXELS, MASKS)
    for order in ([1, 2, 0], [2, 1, 0], [0, 2, 1]):
        goal = matcher.features(PIXELS, MASKS[order])
        assert np.array(order)[matcher.match(rows, goal)].tolist() == [0, 1, 2]
        # One is lost from either picture.
        assert np.array(order)[matcher.match(rows[:2], goal)].tolist() == [0, 1]
    assert matcher.match(rows, rows[1:]).tolist() == [-1, 0, 1]


# ------------------------------------------------------------------ on the env's pictures


def test_turned_household_objects_are_matched_without_colour():
    """All objects of a scene have the same colour: what is left is shape and size."""
    config = real_config("objects=household", "robot=gripper", "n_objects=4").env
    matcher = Matcher(config.perception.encoder)
    worse = Matcher(replace(config.perception.encoder, rotations=1))
    right, unturned = [], []
    with closing(MujocoWorld(config)) as world:
        for seed in range(12):
            episode = draw_episode(seed, world.catalogue, config)
            world.begin(replace(episode, colors=np.tile([0.6, 0.6, 0.6, 1.0], (4, 1))))
            views = world.look(), world.look_at_goal()
            seen = [(view.pixels(), view.true_masks()) for view in views]
            for model, verdicts in ((matcher, right), (worse, unturned)):
                current, goal = (model.features(pixels, masks) for pixels, masks in seen)
                verdicts += (model.match(current, goal[::-1]) == [3, 2, 1, 0]).tolist()
    assert np.mean(right) > 0.85
    assert np.mean(right) > np.mean(unturned) + 0.1


# ------------------------------------------------------------------ ResNet


def test_resnet_names_are_torchvisions():
    with torch.device("meta"):
        networks = {depth: TorchvisionResNet(depth) for depth in DEPTHS}
    keys = {depth: network.state_dict() for depth, network in networks.items()}
    shapes = {
        18: {
            "conv1.weight": (64, 3, 7, 7),
            "bn1.running_var": (64,),
            "layer1.0.conv1.weight": (64, 64, 3, 3),
            "layer2.0.downsample.0.weight": (128, 64, 1, 1),
            "layer2.0.downsample.1.num_batches_tracked": (),
            "layer4.1.bn2.bias": (512,),
            "fc.weight": (1000, 512),
        },
        50: {
            "layer1.0.conv1.weight": (64, 64, 1, 1),
            "layer1.0.downsample.0.weight": (256, 64, 1, 1),
            "layer1.2.conv3.weight": (256, 64, 1, 1),
            "layer2.3.conv2.weight": (128, 128, 3, 3),
            "layer3.5.bn3.weight": (1024,),
            "layer4.2.conv1.weight": (512, 2048, 1, 1),
            "fc.bias": (1000,),
        },
    }
    for depth, expected in shapes.items():
        for key, shape in expected.items():
            assert tuple(keys[depth][key].shape) == shape, key
    # torchvision's published counts of entries and of parameters.
    assert {depth: len(state) for depth, state in keys.items()} == {18: 122, 50: 320}
    parameters = {d: sum(p.numel() for p in net.parameters()) for d, net in networks.items()}
    assert parameters == {18: 11_689_512, 50: 25_557_032}


def test_resnet_forward_by_hand():
    """With every convolution but the first zero, blocks only pass on what came in."""
    network = TorchvisionResNet(18).eval()
    for name, parameter in network.named_parameters():
        if "conv" in name and name != "conv1.weight":
            torch.nn.init.zeros_(parameter)
    x = torch.rand(1, 3, 32, 32)
    stem = network.maxpool(network.relu(network.bn1(network.conv1(x))))
    assert stem.shape == (1, 64, 8, 8)
    torch.testing.assert_close(network.layer1(stem), stem)
    assert network.layer2(stem).shape == (1, 128, 4, 4)
    assert TorchvisionResNet(50).layer1(stem).shape == (1, 256, 8, 8)


def test_resnet_loads_what_the_file_holds(resnet, weights, tmp_path):
    state = torch.load(weights, weights_only=True)
    save_file(state, tmp_path / "same.safetensors")
    # Files older than PyTorch 0.4.1 do not count batches.
    old = {key: value for key, value in state.items() if "num_batches" not in key}
    torch.save(old, tmp_path / "old.pth")
    rows = Matcher(resnet).features(PIXELS, MASKS)
    for name in ("same.safetensors", "old.pth"):
        again = Matcher(replace(resnet, path=str(tmp_path / name))).features(PIXELS, MASKS)
        np.testing.assert_array_equal(again, rows)
    state["layer1.0.conv1.weight"] = -state["layer1.0.conv1.weight"]
    torch.save(state, tmp_path / "other.pth")
    other = Matcher(replace(resnet, path=str(tmp_path / "other.pth"))).features(PIXELS, MASKS)
    assert not np.allclose(other, rows)


# ------------------------------------------------------------------ errors


def test_resnet_needs_its_file(resnet, tmp_path, weights):
    with pytest.raises(SdfgcnError, match=r"set env\.perception\.encoder\.path"):
        Matcher(replace(resnet, path=None))
    with pytest.raises(SdfgcnError, match=r"is 'nowhere\.pth', but there is no such file"):
        Matcher(replace(resnet, path="nowhere.pth"))
    for name in ("broken.pth", "broken.safetensors"):
        (tmp_path / name).write_text("not weights")
        with pytest.raises(SdfgcnError, match=rf"{name}' cannot be read as weights"):
            Matcher(replace(resnet, path=str(tmp_path / name)))
    with pytest.raises(SdfgcnError, match=r"does not hold torchvision's ResNet-50: .*key \"layer1"):
        Matcher(replace(resnet, depth=50))
    state = torch.load(weights, weights_only=True)
    state["fc.weight"] = state["fc.weight"][:10]
    torch.save(state, tmp_path / "ten.pth")
    with pytest.raises(SdfgcnError, match=r"the wrong shape of fc\.weight"):
        Matcher(replace(resnet, path=str(tmp_path / "ten.pth")))
    state = torch.load(weights, weights_only=True)
    state["fc.bias"][3] = torch.nan
    torch.save(state, tmp_path / "nan.pth")
    with pytest.raises(SdfgcnError, match=r"nan\.pth' is damaged: its weights 'fc\.bias' are not"):
        Matcher(replace(resnet, path=str(tmp_path / "nan.pth")))
    torch.save([1, 2], tmp_path / "list.pth")
    with pytest.raises(SdfgcnError, match=r"does not hold torchvision's ResNet-18"):
        Matcher(replace(resnet, path=str(tmp_path / "list.pth")))


class Attack:
    """Makes a file when it is unpickled."""

    def __init__(self, marker):
        self.marker = marker

    def __reduce__(self):
        return os.mknod, (str(self.marker),)


@pytest.mark.parametrize("name", ["bad.pth", "bad.safetensors"])
def test_weights_that_would_run_code_are_refused(resnet, tmp_path, name):
    torch.save({"fc.bias": Attack(tmp_path / "marker")}, tmp_path / name)
    with pytest.raises(SdfgcnError, match=rf"{name}' cannot be read as weights"):
        Matcher(replace(resnet, path=str(tmp_path / name)))
    assert not (tmp_path / "marker").exists()
    torch.load(io.BytesIO((tmp_path / name).read_bytes()), weights_only=False)
    assert (tmp_path / "marker").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "vit"}, r"env\.perception\.encoder\.name is 'vit', but must be one of efficient"),
        ({"stages": [2, 8]}, r"encoder\.stages is \[2, 8\], but must list numbers between 1 and 7"),
        ({"stages": []}, r"encoder\.stages is \[\]"),
    ],
)
def test_what_an_encoder_cannot_be(changes, message):
    with pytest.raises(SdfgcnError, match=message):
        Matcher(replace(real_config().env.perception.encoder, **changes))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("patch=0", "patch is 0.0, but must lie between 0.02 and 1"),
        ("input_size=8", "input_size is 8, but must lie between 32 and 512"),
        ("rotations=0", "rotations is 0, but must lie between 1 and 360"),
        ("color_weight=-1", "color_weight is -1.0, but must lie between 0 and 1000"),
    ],
)
def test_numbers_out_of_range(override, message):
    with pytest.raises(SdfgcnError, match=message):
        real_config(f"env.perception.encoder.{override}")


def test_a_depth_that_resnet_does_not_have():
    with pytest.raises(SdfgcnError, match=r"encoder\.depth is 34, but must be one of 18, 50"):
        real_config("encoder=resnet", "env.perception.encoder.depth=34")


def test_the_tilt_is_the_cameras():
    config = real_config("env.arena.camera_tilt=20")
    assert math.isclose(config.env.perception.encoder.camera_tilt, 20.0)
