"""The projection onto the posed mesh: around its surface, edges and corners; meshes thin, folded, tiny, huge or far away."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh

from ndf_mi.stability.ball import icosphere
from ndf_mi.stability.case import Measured, case
from ndf_mi.stability.projections import Shape, judge

LENGTHS = "lengths to the longest edge and the distance; directions to 1 on faces, else to that ratio; texels to the largest"


def ball() -> Shape:
    """A closed mesh of 320 triangles of which no edge is along an axis."""
    vertices, faces = icosphere()
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    return Shape((vertices @ turn.T).astype(np.float32), faces)


def box(extents: tuple[float, float, float] = (0.6, 0.4, 0.2), centre: tuple[float, float, float] = (0, 0, 0)) -> Shape:
    """A box of 12 triangles along the axes."""
    mesh = trimesh.creation.box(extents)
    return Shape((mesh.vertices + centre).astype(np.float32), np.asarray(mesh.faces, np.int32))


def scattered(shape: Shape, count: int, reach: float, seed: int = 0) -> np.ndarray:
    """(count, 3) points up to `reach` away from random points of a mesh."""
    rng = np.random.default_rng(seed)
    corners = shape.vertices[shape.faces[rng.integers(len(shape.faces), size=count)]].astype(np.float64)
    on = np.einsum("nk,nki->ni", rng.dirichlet((1, 1, 1), count), corners)
    way = rng.normal(size=(count, 3))
    return on + way * (rng.uniform(0, reach, count) / np.linalg.norm(way, axis=1))[:, None]


def normals(shape: Shape) -> np.ndarray:
    """(F, 3) unit normals."""
    a, b, c = (shape.vertices.astype(np.float64)[shape.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


@case("points on the surface, at l = 0 exactly, and straight off its faces", "l of 0 and ±1e-38 to ±0.1 m", relative_to=LENGTHS)
def on_the_surface() -> Iterator[Measured]:
    """A box with a face in the plane z = 0, so that any l can be said."""
    shape = box((2, 2, 1), (0, 0, -0.5))
    rng = np.random.default_rng(1)
    xy = np.concatenate([rng.uniform(-0.9, 0.9, (64, 2)), [[0.25, 0.25], [-0.5, 0.125], [0, 0]]])
    for l in (0.0, *(sign * 10.0**decade for decade in range(-38, 0, 2) for sign in (1, -1)), 0.1, -0.05):
        points = np.concatenate([xy, np.full((len(xy), 1), l)], 1)
        yield judge(f"{l:g} m", shape, points, 0.2, np.full(len(points), -1 if l < 0 else 0 if l == 0 else 1), smooth=False)


@case("points on vertices and edges, and straight off them", "0 and ±1e-7 to ±0.1 m", relative_to=LENGTHS)
def on_edges_and_vertices() -> Iterator[Measured]:
    """All vertices and the middles of all edges of a ball and of a box, where several triangles are equally close, each with a chart of its
    own: the texel is that of the chart found. The box's are on its edges exactly, as numbers go."""
    for distance in (0.0, *(sign * 10.0**decade for decade in range(-7, 0) for sign in (1, -1))):
        found = [_borders(shape, distance) for shape in (ball(), box((0.5, 0.25, 1.0)))]
        yield Measured(f"{distance:g} m", max(r.primal for r in found), max(r.gradient or 0 for r in found))


def _borders(shape: Shape, distance: float) -> Measured:
    vertices = shape.vertices.astype(np.float64)
    edges = np.unique(np.sort(shape.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0)
    normal = normals(shape)
    around = np.zeros_like(vertices)
    np.add.at(around, shape.faces.ravel(), np.repeat(normal, 3, 0))
    away = np.concatenate([around, around[edges].sum(1)])
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    places = np.concatenate([vertices, vertices[edges].mean(1)])
    # Of what is closer than rounding, float32 has lost the side.
    sign = np.full(len(places), 0 if abs(distance) < 1e-6 else np.sign(distance))
    return judge("", shape, places + distance * away, 0.2, sign, smooth=False)


@case("points around a mesh: texels and their derivatives too", "0 to 0.25 m",
      relative_to=LENGTHS + ", derivatives of texels to the largest")
def around_the_surface() -> Iterator[Measured]:
    """Random points about a ball in which each edge is a seam."""
    shape = ball()
    for reach in (0.01, 0.05, 0.25):
        yield judge(f"{reach:g} m", shape, scattered(shape, 2000, reach), 0.3)


@case("points on the medial axis: as far from many places as from one", "off it by 0 and 1e-7 to 1e-1 m", relative_to=LENGTHS)
def medial_axis() -> Iterator[Measured]:
    """The centre of a ball, and the middle sheet of a flat box."""
    rng = np.random.default_rng(2)
    sheet = np.concatenate([rng.uniform(-0.15, 0.15, (200, 2)) * [1.2, 0.6], np.zeros((200, 1))], 1)
    for off in (0.0, *(10.0**decade for decade in range(-7, 0))):
        way = rng.normal(size=(200, 3))
        way *= off / np.linalg.norm(way, axis=1, keepdims=True)
        centre = judge("", ball(), way, 0.4, smooth=False)
        flat = judge("", box(), sheet + way * [1, 1, 0.9], 0.4, smooth=False)
        yield Measured(f"{off:g} m", max(centre.primal, flat.primal), max(centre.gradient or 0, flat.gradient or 0))


@case("points at equal distance from limbs that are far apart in texels", "off the middle by 0 and ±1e-7 to ±1e-2 m", relative_to=LENGTHS)
def between_limbs() -> Iterator[Measured]:
    """Two boxes 10 cm apart, and points in and about the plane between them: the closer one is found, or either."""
    left, right = box((0.1, 0.8, 0.1), (-0.1, 0, 0)), box((0.1, 0.8, 0.1), (0.1, 0, 0))
    shape = Shape(np.concatenate([left.vertices, right.vertices]), np.concatenate([left.faces, right.faces + len(left.vertices)]))
    rng = np.random.default_rng(3)
    plane = np.concatenate([np.zeros((300, 1)), rng.uniform(-0.35, 0.35, (300, 1)), rng.uniform(-0.04, 0.04, (300, 1))], 1)
    for off in (0.0, *(sign * 10.0**decade for decade in range(-7, -1) for sign in (1, -1))):
        yield judge(f"{off:g} m", shape, plane + [off, 0, 0], 0.2, smooth=False)


@case("slivers, from triangles as thin as they get to those without area", "angles of 1 to 1e-20 and 0, at each corner",
      relative_to=LENGTHS)
def slivers() -> Iterator[Measured]:
    """Lone triangles, two of their sides apart by an angle at one corner or at two; each corner comes first once."""
    rng = np.random.default_rng(4)
    for angle in (*(10.0**-k for k in range(21)), 0.0):
        sharp = [[0, 0, 0], [0.5, 0, 0], [0.5 * np.cos(angle), 0.5 * np.sin(angle), 0]]
        flat = [[0, 0, 0], [0.5, 0, 0], [0.21, 0.29 * min(angle, 1), 0]]
        # One above the other, far enough apart not to mix.
        corners = np.concatenate([np.roll(np.array(kind), first, 0) + [0, 0, 2.0 * (3 * place + first)]
                                  for place, kind in enumerate((sharp, flat)) for first in range(3)]).astype(np.float32)
        shape = Shape(corners, np.arange(18).reshape(6, 3), closed=False)
        on = np.einsum("nfk,fki->nfi", rng.dirichlet((1, 1, 1), (60, 6)), corners.reshape(6, 3, 3).astype(np.float64)).reshape(-1, 3)
        points = np.concatenate([on, on + rng.normal(0, 0.03, on.shape), on + rng.normal(0, 0.03 * angle, on.shape)])
        yield judge(f"{angle:g}", shape, points, 0.5, smooth=False)
    for flattened in ([[0.1, 0.2, 0.3]] * 3, [[0, 0, 0], [0, 0, 0], [0.4, 0.1, 0]], [[0, 0, 0], [0.5, 0.5, 0.5], [0.25, 0.25, 0.25]]):
        shape = Shape(np.array(flattened, np.float32), np.array([[0, 1, 2]]), closed=False)
        points = rng.uniform(-0.2, 0.6, (100, 3))
        yield judge("no area", shape, points, 2.0, smooth=False)


@case("folded sheets and meshes that touch themselves", "gaps of 0 and 1e-7 to 1e-1 m", relative_to=LENGTHS)
def folded_and_touching() -> Iterator[Measured]:
    """Two boxes with a gap between them, and a box flattened to that height: the distance is right everywhere, its sign wherever there
    is an inside to tell."""
    for gap in (0.0, *(10.0**decade for decade in range(-7, 0))):
        first, second = box((0.3, 0.3, 0.3), (-0.15, 0, 0)), box((0.3, 0.3, 0.3), (0.15 + gap, 0, 0))
        both = Shape(np.concatenate([first.vertices, second.vertices]), np.concatenate([first.faces, second.faces + 8]))
        flat = box((0.5, 0.5, 0.0))
        flat.vertices[:, 2] = np.where(np.arange(8) % 2, gap / 2, -gap / 2)
        results = []
        for shape in (both, flat):
            points = scattered(shape, 300, 0.1)
            nothing = np.zeros(300, int) if gap == 0 else None
            results.append(judge("", shape, points, 0.3, nothing, smooth=False))
        yield Measured(f"{gap:g} m", max(r.primal for r in results), max(r.gradient or 0 for r in results))


@case("texture coordinates that reach beyond [0, 1]", "shifted and scaled by 1e-6 to 1e6", relative_to="the largest coordinate")
def texels_outside() -> Iterator[Measured]:
    """A body's are within; a surface takes any, and interpolates them as they are."""
    shape = ball()
    points = scattered(shape, 500, 0.1)
    for decade in range(-6, 7, 2):
        uv = (10.0**decade * (shape.texels.reshape(-1, 2) - [3.0, -2.0])).astype(np.float32)
        yield judge(f"1e{decade}", Shape(shape.vertices, shape.faces, uv=uv), points, 0.2)


@case("bodies of any size, at any place", "1 mm to 1 km, 0 to 1e6 m from the origin; triangles down to 10 nm",
      relative_to="lengths to the longest edge, or to what float32 can tell at that place")
def sizes_and_places() -> Iterator[Measured]:
    """The mesh and the points are rounded to float32 before anything is compared: what rounding has made of a body far away, down to a
    single point, is taken as it is. Meshes below a millimetre stand for the small triangles of larger bodies."""
    vertices, faces = ball().vertices.astype(np.float64) / 0.6, ball().faces
    for decade in range(-7, 4):
        size = 10.0**decade
        for place in (0.0, 1.0, 1e3, 1e6) if decade >= -3 else (0.0,):
            shape = Shape((vertices * size + place * np.array([0.6, -0.8, 0.0])).astype(np.float32), faces)
            # Where rounding has folded the mesh onto itself, there is no inside to tell.
            step = np.spacing(np.float32(place))
            sharp = step < 1e-4 * size
            points = scattered(shape, 200, 0.2 * size + 2 * step)
            sign = None if sharp else np.zeros(200, int)
            yield judge(f"{size:g} m at {place:g} m", shape, points, 0.5 * size + 8 * step, sign, smooth=bool(step < 1e-6 * size))
