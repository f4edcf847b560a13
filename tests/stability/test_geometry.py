"""The projection: around surface, edges and corners; onto meshes thin, folded, tiny, huge or far away."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from ndf_mi.stability.ball import icosphere
from ndf_mi.stability.case import Check, case, decades
from ndf_mi.stability.projections import Normals, Shape, judge

LENGTHS = (
    "lengths to the longest edge and the distance; directions to 1 on faces, else to that ratio; UVs to the "
    "largest")


def turned_ball() -> Shape:
    """A closed mesh of 320 triangles, none of whose edges is along an axis."""
    vertices, faces = icosphere()
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    return Shape((vertices @ turn.T).astype(np.float32), faces)


def box(
    extents: tuple[float, float, float] = (0.6, 0.4, 0.2), centre: tuple[float, float, float] = (0, 0, 0)
) -> Shape:
    """A box of 12 triangles along the axes."""
    mesh = trimesh.creation.box(extents)
    return Shape((mesh.vertices + centre).astype(np.float32), np.asarray(mesh.faces, np.int32))


def joined(first: Shape, second: Shape) -> Shape:
    """Two meshes as one."""
    return Shape(
        np.concatenate([first.vertices, second.vertices]),
        np.concatenate([first.faces, second.faces + len(first.vertices)]))


def scattered(shape: Shape, count: int, reach: float) -> np.ndarray:
    """(count, 3) points up to `reach` away from random points of a mesh."""
    rng = np.random.default_rng(0)
    corners = shape.vertices[shape.faces[rng.integers(len(shape.faces), size=count)]].astype(np.float64)
    on = np.einsum("nk,nki->ni", rng.dirichlet((1, 1, 1), count), corners)
    return on + directions(rng, count) * rng.uniform(0, reach, (count, 1))


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) random unit vectors."""
    way = rng.normal(size=(count, 3))
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def check_all(check: Check, *errors: tuple[float, float]) -> None:
    """Checks the largest of several errors."""
    check(max(primal for primal, _ in errors), max(gradient for _, gradient in errors))


@case(
    "points on the surface, at l = 0 exactly, and straight off its faces", "l of 0 and ±1e-38 to ±0.1 m",
    relative_to=LENGTHS)
@pytest.mark.parametrize("l", [0.0, *decades(-38, -2, 2, (1, -1)), 0.1, -0.05], ids="{:g} m".format)
def test_on_the_surface(check: Check, l: float) -> None:
    """A box with a face in the plane z = 0, where float32 can hold any l."""
    rng = np.random.default_rng(1)
    xy = np.concatenate([rng.uniform(-0.9, 0.9, (64, 2)), [[0.25, 0.25], [-0.5, 0.125], [0, 0]]])
    points = np.concatenate([xy, np.full((len(xy), 1), l)], 1)
    check(*judge(box((2, 2, 1), (0, 0, -0.5)), points, 0.2, np.full(len(points), np.sign(l)), smooth=False))


@case("points on vertices and edges, and straight off them", "0 and ±1e-7 to ±0.1 m", relative_to=LENGTHS)
@pytest.mark.parametrize("distance", [0.0, *decades(-7, -1, 1, (1, -1))], ids="{:g} m".format)
def test_on_edges_and_vertices(check: Check, distance: float) -> None:
    """All vertices and middles of edges of a ball and a box, where several triangles are equally close, each
    with a chart of its own.

    UVs must be those of the triangle found. The box's points are exactly on its edges in float32.
    """
    check_all(check, *(_borders(shape, distance) for shape in (turned_ball(), box((0.5, 0.25, 1.0)))))


def _borders(shape: Shape, distance: float) -> tuple[float, float]:
    vertices = shape.vertices.astype(np.float64)
    edges = np.unique(np.sort(shape.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0)
    around = np.zeros_like(vertices)
    np.add.at(around, shape.faces.ravel(), np.repeat(Normals(vertices, shape.faces).face, 3, 0))
    away = np.concatenate([around, around[edges].sum(1)])
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    places = np.concatenate([vertices, vertices[edges].mean(1)])
    # Below a rounding error, float32 does not know the side.
    sign = np.full(len(places), 0 if abs(distance) < 1e-6 else np.sign(distance))
    return judge(shape, places + distance * away, 0.2, sign, smooth=False)


@case("points around a mesh, with UVs and their derivatives", "0 to 0.25 m",
      relative_to=LENGTHS + ", derivatives of UVs to the largest")
@pytest.mark.parametrize("reach", [0.01, 0.05, 0.25], ids="{:g} m".format)
def test_around_the_surface(check: Check, reach: float) -> None:
    """Random points around a ball in which each edge is a seam."""
    check(*judge(turned_ball(), scattered(turned_ball(), 2000, reach), 0.3))


@case(
    "points on the medial axis: equally far from many places", "off it by 0 and 1e-7 to 1e-1 m",
    relative_to=LENGTHS)
@pytest.mark.parametrize("off", [0.0, *decades(-7, -1)], ids="{:g} m".format)
def test_medial_axis(check: Check, off: float) -> None:
    """The centre of a ball, and the middle sheet of a flat box."""
    rng = np.random.default_rng(2)
    sheet = np.concatenate([rng.uniform(-0.15, 0.15, (200, 2)) * [1.2, 0.6], np.zeros((200, 1))], 1)
    way = off * directions(rng, 200)
    check_all(
        check, judge(turned_ball(), way, 0.4, smooth=False),
        judge(box(), sheet + way * [1, 1, 0.9], 0.4, smooth=False))


@case(
    "points at equal distance from limbs that are far apart in UV",
    "off the middle by 0 and ±1e-7 to ±1e-2 m", relative_to=LENGTHS)
@pytest.mark.parametrize("off", [0.0, *decades(-7, -2, 1, (1, -1))], ids="{:g} m".format)
def test_between_limbs(check: Check, off: float) -> None:
    """Two boxes 10 cm apart, and points in and near the plane between them, where either may be found."""
    shape = joined(box((0.1, 0.8, 0.1), (-0.1, 0, 0)), box((0.1, 0.8, 0.1), (0.1, 0, 0)))
    rng = np.random.default_rng(3)
    plane = np.concatenate(
        [np.zeros((300, 1)), rng.uniform(-0.35, 0.35, (300, 1)), rng.uniform(-0.04, 0.04, (300, 1))], 1)
    check(*judge(shape, plane + [off, 0, 0], 0.2, smooth=False))


SLIVERS = case(
    "slivers, from the thinnest triangles to those without area",
    "angles of 1 to 1e-20 and 0, at each corner", relative_to=LENGTHS)


@SLIVERS
@pytest.mark.parametrize("angle", [*decades(0, -20, -1), 0.0], ids="{:g}".format)
def test_slivers(check: Check, angle: float) -> None:
    """Separate triangles with a small angle at one corner or at two; each corner comes first once."""
    rng = np.random.default_rng(4)
    sharp = [[0, 0, 0], [0.5, 0, 0], [0.5 * np.cos(angle), 0.5 * np.sin(angle), 0]]
    flat = [[0, 0, 0], [0.5, 0, 0], [0.21, 0.29 * min(angle, 1), 0]]
    # One above the other, too far apart to interfere.
    corners = np.concatenate(
        [
            np.roll(np.array(kind), first, 0) + [0, 0, 2.0 * (3 * place + first)]
            for place, kind in enumerate((sharp, flat)) for first in range(3)]
    ).astype(np.float32)
    shape = Shape(corners, np.arange(18).reshape(6, 3), closed=False)
    weights = rng.dirichlet((1, 1, 1), (60, 6))
    on = np.einsum("nfk,fki->nfi", weights, corners.reshape(6, 3, 3).astype(np.float64)).reshape(-1, 3)
    points = np.concatenate(
        [on, on + rng.normal(0, 0.03, on.shape), on + rng.normal(0, 0.03 * angle, on.shape)])
    check(*judge(shape, points, 0.5, smooth=False))


@SLIVERS
@pytest.mark.parametrize(
    "corners",
    [
        [[0.1, 0.2, 0.3]] * 3, [[0, 0, 0], [0, 0, 0], [0.4, 0.1, 0]],
        [[0, 0, 0], [0.5, 0.5, 0.5], [0.25, 0.25, 0.25]]],
    ids=["a point", "two corners in one", "a line"],
)
def test_slivers_without_area(check: Check, corners: list[list[float]]) -> None:
    shape = Shape(np.array(corners, np.float32), np.array([[0, 1, 2]]), closed=False)
    check(*judge(shape, np.random.default_rng(4).uniform(-0.2, 0.6, (100, 3)), 2.0, smooth=False))


@case("folded sheets and meshes that touch themselves", "gaps of 0 and 1e-7 to 1e-1 m", relative_to=LENGTHS)
@pytest.mark.parametrize("gap", [0.0, *decades(-7, -1)], ids="{:g} m".format)
def test_folded_and_touching(check: Check, gap: float) -> None:
    """Two boxes with a gap between them, and a box flattened to that height. The sign is compared wherever
    there is an inside."""
    both = joined(box((0.3, 0.3, 0.3), (-0.15, 0, 0)), box((0.3, 0.3, 0.3), (0.15 + gap, 0, 0)))
    flat = box((0.5, 0.5, 0.0))
    flat.vertices[:, 2] = np.where(np.arange(8) % 2, gap / 2, -gap / 2)
    either = np.zeros(300, int) if gap == 0 else None
    check_all(
        check,
        *(judge(shape, scattered(shape, 300, 0.1), 0.3, either, smooth=False) for shape in (both, flat)))


@case(
    "texture coordinates that reach beyond [0, 1]", "shifted and scaled by 1e-6 to 1e6",
    relative_to="the largest coordinate")
@pytest.mark.parametrize("scale", decades(-6, 6, 2), ids="{:g}".format)
def test_uv_outside(check: Check, scale: float) -> None:
    """A body's are within, but a surface interpolates any."""
    shape = turned_ball()
    uv = (scale * (shape.corner_uv.reshape(-1, 2) - [3.0, -2.0])).astype(np.float32)
    check(*judge(Shape(shape.vertices, shape.faces, uv=uv), scattered(shape, 500, 0.1), 0.2))


@case("bodies of any size, at any place", "1 mm to 1 km, 0 to 1e6 m from the origin; triangles down to 10 nm",
      relative_to="lengths to the longest edge, or to float32's spacing at that place")
@pytest.mark.parametrize(
    ("size", "place"),
    [
        (10.0**decade, place) for decade in range(-7, 4)
        for place in ((0.0, 1.0, 1e3, 1e6) if decade >= -3 else (0.0,))],
    ids="{:g} m".format,
)
def test_sizes_and_places(check: Check, size: float, place: float) -> None:
    """The mesh and the points are rounded to float32 first: whatever remains of a body far away is the truth.
    Meshes below a millimetre stand for the small triangles of larger bodies."""
    ball = turned_ball()
    moved = ball.vertices.astype(np.float64) / 0.6 * size + place * np.array([0.6, -0.8, 0.0])
    shape = Shape(moved.astype(np.float32), ball.faces)
    spacing = np.spacing(np.float32(place))
    # Rounding may have folded the mesh onto itself; then there is no inside.
    sign = None if spacing < 1e-4 * size else np.zeros(200, int)
    points = scattered(shape, 200, 0.2 * size + 2 * spacing)
    check(*judge(shape, points, 0.5 * size + 8 * spacing, sign, smooth=bool(spacing < 1e-6 * size)))
