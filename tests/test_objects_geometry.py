"""Hulls, cuts, meshes and resting poses against cases worked out by hand."""

import struct

import numpy as np
import pytest
from configs import real_config
from scipy.spatial import ConvexHull

from sdfgcn.objects import primitives
from sdfgcn.objects.convex import (
    compound_volume_centroid,
    diameter,
    hull_vertices,
    merge_pieces,
    slice_into_hulls,
)
from sdfgcn.objects.meshes import decimate, mesh_volume, weld
from sdfgcn.objects.primitives import box, circle, join, prism, turned_solid, turned_vessel
from sdfgcn.objects.resting import components, find_rests
from sdfgcn.objects.sources.scanned import read_msh, read_stl


def test_compound_of_two_boxes():
    first, second = box(2, 2, 2), box(2, 2, 4).moved(x=4)
    volume, centre = compound_volume_centroid([*first.pieces, *second.pieces])
    assert volume == pytest.approx(8 + 16)
    np.testing.assert_allclose(
        centre, [(8 * 0 + 16 * 4) / 24, 0, (8 * 1 + 16 * 2) / 24], atol=1e-12
    )


def test_diameter_of_a_box():
    assert diameter(box(1, 2, 2).vertices) == pytest.approx(3.0)


def test_reduced_hull_keeps_corners_and_volume():
    rng = np.random.default_rng(0)
    corners = box(1, 1, 1).vertices
    cloud = np.concatenate([corners, corners * 0.5 + 0.1 * rng.random((8, 3))])
    np.testing.assert_allclose(sorted(hull_vertices(cloud, 8).tolist()), sorted(corners.tolist()))
    ball = rng.normal(size=(500, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    small = hull_vertices(ball, 40)
    assert len(small) == 40
    assert ConvexHull(small).volume == pytest.approx(ConvexHull(ball).volume)


def test_merging_joins_what_fills_least():
    row = [box(1, 1, 1).moved(x=x).vertices for x in (0.0, 1.0, 10.0)]
    merged = merge_pieces(row, 2)
    assert sorted(ConvexHull(piece).volume for piece in merged) == pytest.approx([1.0, 2.0])


def test_slicing_an_l_fills_it_and_no_more():
    outline = join(box(3, 1, 1), box(1, 3, 1).moved(x=-1, y=2))
    pieces = slice_into_hulls(outline.vertices, outline.faces, 3)
    # Hull of the L: 4 x 3 with the corner cut off; its area is 6 + the triangle between the arms.
    assert 6.0 - 1e-6 <= sum(ConvexHull(piece).volume for piece in pieces) < 7.0
    for point in outline.vertices:
        reach = [(ConvexHull(piece).equations @ [*point, 1.0]).max() <= 1e-3 for piece in pieces]
        assert any(reach)


def test_decimation_keeps_a_box_sharp():
    n = 30
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, n)] * 2, indexing="ij"), -1).reshape(-1, 2)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    quad = np.concatenate(
        [np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)]
    )
    triangles = []
    for axis in range(3):
        for level in (0.0, 1.0):
            points = np.insert(grid, axis, level, axis=1)[quad]
            flip = (level == 0.0) == (axis != 1)
            triangles.append(points[:, ::-1] if flip else points)
    vertices, faces = weld(np.concatenate(triangles))
    assert mesh_volume(vertices, faces) == pytest.approx(1.0)
    small, few, _ = decimate(vertices, faces, None, 1000)
    assert 300 < len(few) <= 1000
    assert mesh_volume(small, few) == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(np.ptp(small, axis=0), 1.0, atol=1e-6)


def test_linked_poses_are_grouped_in_order_of_their_first_member():
    linked = np.eye(6, dtype=bool)
    for one, other in ((0, 3), (3, 5), (1, 4)):
        linked[one, other] = linked[other, one] = True
    assert components(linked) == [[0, 3, 5], [1, 4], [2]]


def test_decimation_keeps_uv_with_the_vertices():
    part = turned_solid([(1.0, z) for z in np.linspace(0, 2, 30)])
    uv = part.vertices[:, 1:] * 0.1  # a linear map: it must still hold after the reduction
    vertices, faces, reduced = decimate(part.vertices, part.faces, uv, 600)
    assert len(faces) <= 600 and reduced is not None
    assert np.abs(reduced - vertices[:, 1:] * 0.1).max() < 0.03


def test_small_mesh_is_left_alone():
    cube = box(1, 1, 1)
    vertices, faces, uv = decimate(cube.vertices, cube.faces, None, 100)
    assert vertices is cube.vertices and faces is cube.faces and uv is None


@pytest.mark.parametrize(
    ("part", "volume"),
    [
        (box(1, 2, 3), 6.0),
        (prism(circle(1.0, 4), 2.0), 4.0),
        (turned_solid([(1.0, 0.0), (1.0, 2.0)]), 2.0 * 16 * np.sin(2 * np.pi / 32)),
        (
            turned_vessel([(1.0, 0.0), (1.0, 2.0)], wall=0.5, base=0.5),
            (2.0 - 0.25 * 1.5) * 16 * np.sin(2 * np.pi / 32),
        ),
        (
            primitives.rod(np.array([[0, 0, 0], [2.0, 0, 0]]), 0.5),
            2.0 * 0.25 * 4 * np.sin(np.pi / 4),
        ),
    ],
    ids=["box", "prism", "turned_solid", "turned_vessel", "rod"],
)
def test_primitives_have_their_volume(part, volume):
    assert mesh_volume(part.vertices, part.faces) == pytest.approx(volume)


def test_vessel_is_empty_inside():
    vessel = turned_vessel([(1.0, 0.0), (1.0, 2.0)], wall=0.2, base=0.2)
    for piece in vessel.pieces:
        assert (ConvexHull(piece).equations @ [0.0, 0.0, 1.0, 1.0]).max() > 0.3
    floor = [(ConvexHull(p).equations @ [0.0, 0.0, 0.1, 1.0]).max() < 0 for p in vessel.pieces]
    assert sum(floor) == 1


def test_a_flat_box_rests_on_its_six_faces_at_most():
    cfg = real_config("objects=household").env.objects
    piece = box(0.08, 0.06, 0.02).moved(z=-0.01).vertices
    rests = find_rests([piece], cfg, np.random.default_rng(0))
    down = np.array([rotation.inv().apply([0, 0, -1]) for rotation, _ in rests])
    np.testing.assert_allclose(np.abs(down).max(axis=1), 1.0, atol=1e-3)
    assert np.abs(down[0, 2]) == pytest.approx(1.0, abs=1e-3)  # the largest face comes first
    assert sum(share for _, share in rests) == pytest.approx(1.0)


def test_a_rolling_can_counts_as_one_family():
    cfg = real_config("objects=household").env.objects
    piece = np.concatenate(
        [np.column_stack([circle(0.03, 24), np.full(24, z)]) for z in (-0.04, 0.04)]
    )
    rests = find_rests([piece], cfg, np.random.default_rng(0))
    lying = sum(
        share for rotation, share in rests if abs(rotation.inv().apply([0, 0, -1])[2]) < 0.1
    )
    assert lying > 0.4  # split up by roll angle, each share alone would be too rare


def test_readers_refuse_cut_files(tmp_path):
    triangle = np.zeros(1, np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    triangle["c"] = np.arange(9).reshape(3, 3)
    stl = tmp_path / "a.stl"
    stl.write_bytes(bytes(80) + struct.pack("<I", 1) + triangle.tobytes())
    np.testing.assert_array_equal(read_stl(stl)[0], np.arange(9).reshape(3, 3))
    stl.write_bytes(stl.read_bytes()[:-1])
    with pytest.raises(ValueError, match="133 bytes instead of 134"):
        read_stl(stl)
    msh = tmp_path / "a.msh"
    content = struct.pack("<4i", 3, 0, 3, 1) + np.arange(15, dtype="<f4").tobytes()
    msh.write_bytes(content + struct.pack("<3i", 0, 1, 2))
    vertices, uv, faces = read_msh(msh)
    assert vertices[2].tolist() == [6, 7, 8] and uv[0].tolist() == [9, 10]
    assert faces.tolist() == [[0, 1, 2]]
    msh.write_bytes(content)
    with pytest.raises(ValueError, match="instead of"):
        read_msh(msh)
