"""A scene from detections made by hand, and what can be done with whole scenes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from sdfgcn.perception.sdf import SdfTransform
from sdfgcn.task.scene import Detections, Scene, scene_field

N, SIZE = 4, 8
ROWS = np.array([False, True, False, True])


def corner(rows: slice, columns: slice) -> np.ndarray:
    mask = np.zeros((SIZE, SIZE), dtype=bool)
    mask[rows, columns] = True
    return mask


MASKS = np.stack([corner(slice(0, 3), slice(0, 2)), corner(slice(5, 8), slice(4, 8))])


@pytest.fixture
def seen() -> Detections:
    return Detections(
        masks=MASKS,
        sdf=SdfTransform("edt", SIZE).fields(MASKS),
        center=np.array([[-0.2, 0.1], [0.15, -0.05]]),
        position=np.array([[-0.21, 0.12], [0.16, -0.04]]),
    )


@pytest.fixture
def scene(seen: Detections) -> Scene:
    return Scene.of(seen, ROWS, N, SIZE)


class AreaScene(Scene):
    """With the number of pixels of each object."""

    area: Tensor = scene_field(lambda seen: seen.masks.sum(axis=(1, 2)))


def test_detections_stand_in_their_rows_and_zeros_elsewhere(scene, seen):
    assert scene.batch_size == torch.Size([])
    assert scene.node_mask.tolist() == [False, True, False, True]
    np.testing.assert_array_equal(scene.sdf[[1, 3]], seen.sdf)
    np.testing.assert_allclose(scene.center[[1, 3]], seen.center, atol=1e-7)
    np.testing.assert_allclose(scene.position[[1, 3]], seen.position, atol=1e-7)
    for values in (scene.sdf, scene.center, scene.position):
        assert values.dtype == torch.float32
        assert not values[[0, 2]].any()
    np.testing.assert_array_equal(scene.masks[[1, 3]], MASKS)
    assert not scene.masks[[0, 2]].any()


def test_fewer_rows_than_the_scene_has(seen):
    scene = Scene.of(seen, np.array([True, True]), N, SIZE)
    assert scene.node_mask.tolist() == [True, True, False, False]
    assert scene.sdf.shape == (N, SIZE, SIZE)


def test_nothing_detected():
    empty = np.zeros((0, SIZE, SIZE))
    nothing = Detections(empty.astype(bool), empty.astype(np.float32), *[np.zeros((0, 2))] * 2)
    scene = Scene.of(nothing, np.zeros(3, dtype=bool), N, SIZE)
    assert not scene.node_mask.any() and not scene.sdf.any() and not scene.center.any()


def test_the_spec_is_that_of_the_scene(scene):
    spec = Scene.spec(N, SIZE)
    assert spec.is_in(scene)
    assert isinstance(spec.rand(), Scene)
    assert set(spec.keys()) == {"sdf", "node_mask", "center", "position"}
    for key, leaf in spec.items():
        values = scene.get(key)
        assert (leaf.shape, leaf.dtype) == (values.shape, values.dtype), key


def test_mirrored_by_hand(scene, seen):
    mirrored = scene.mirrored()
    # Columns 0 and 1 become the last two; x changes its sign, y does not.
    assert torch.equal(mirrored.masks[1], torch.from_numpy(corner(slice(0, 3), slice(6, 8))))
    assert torch.equal(mirrored.masks[3], torch.from_numpy(corner(slice(5, 8), slice(0, 4))))
    np.testing.assert_allclose(mirrored.center[[1, 3]], [[0.2, 0.1], [-0.15, -0.05]], atol=1e-7)
    np.testing.assert_allclose(mirrored.position[[1, 3]], [[0.21, 0.12], [-0.16, -0.04]], atol=1e-7)
    assert torch.equal(mirrored.node_mask, scene.node_mask)
    # The scene itself is left as it was.
    np.testing.assert_array_equal(scene.sdf[[1, 3]], seen.sdf)
    assert (mirrored.mirrored() == scene).all()


def test_a_batch_is_mirrored_like_each_of_it(scene):
    batch = torch.stack([scene, scene.mirrored()])
    assert batch.batch_size == torch.Size([2])
    assert (batch.mirrored() == batch.flip(0)).all()


def test_packed_and_unpacked(scene):
    transform = SdfTransform("edt", SIZE)
    batch = torch.stack([scene, scene.mirrored()])
    packed = batch.packed(transform.pack)
    assert (packed.sdf.dtype, packed.sdf.shape) == (torch.uint8, (2, N, SIZE * SIZE // 8))
    # Bits of the mask: rows 0 to 2 hold two pixels each, 0b11000000.
    assert packed.sdf[0, 1].tolist() == [192, 192, 192, 0, 0, 0, 0, 0]
    assert packed.sdf[0, 0].tolist() == [0] * 8
    assert torch.equal(packed.center, batch.center)
    # Whoever unpacks need not have seen the fields before.
    for other in (transform, SdfTransform("edt", SIZE)):
        assert (packed.unpacked(other.unpack) == batch).all()


def test_by_row_is_the_same_data(scene):
    by_row = scene.by_row()
    assert by_row.batch_size == torch.Size([N])
    assert scene.batch_size == torch.Size([])
    by_row[0] = by_row[3]
    assert torch.equal(scene.sdf[0], scene.sdf[3])
    assert scene.node_mask.tolist() == [True, True, False, True]
    np.testing.assert_allclose(scene.center[0], [0.15, -0.05], atol=1e-7)
    batch = torch.stack([scene, scene])
    assert batch.by_row().batch_size == torch.Size([2, N])


def test_a_field_more_goes_through_all_of_it(seen):
    scene = AreaScene.of(seen, ROWS, N, SIZE)
    assert scene.area.tolist() == [0.0, 6.0, 0.0, 12.0]
    assert AreaScene.spec(N, SIZE).is_in(scene)
    transform = SdfTransform("edt", SIZE)
    for changed in (
        scene.mirrored(),
        scene.packed(transform.pack).unpacked(transform.unpack),
        scene.by_row(),
    ):
        assert isinstance(changed, AreaScene)
        assert changed.area.tolist() == [0.0, 6.0, 0.0, 12.0]
