"""Shells: closed, simple, and around all of the band, by libigl's winding numbers and distances and by brute
force."""

import igl
import mitsuba as mi
import numpy as np
import pytest
import trimesh

from ndf_mi.body.anny import load_anny
from ndf_mi.body.motion import load_clip, pose_sequence
from ndf_mi.projection import Bands, PosedSurface, Surface
from ndf_mi.render.shell import Grid, band_points, band_shell, corners_of, cut, reduce_parts, spread

BAND, INSIDE, CELL = 0.06, 0.025, 0.02


def capsule(start, end, radius):
    """A capsule between two points."""
    start, end = np.array(start, float), np.array(end, float)
    mesh = trimesh.creation.capsule(height=float(np.linalg.norm(end - start)), radius=radius, count=[12, 12])
    mesh.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], end - start))
    mesh.apply_translation(start)
    return mesh


BODIES = {
    "ball": [trimesh.creation.icosphere(2, 0.12)],
    "limbs a centimetre apart": [capsule([0, 0, 0], [0, 0.3, 0], 0.07),
                                 capsule([0.15, 0, 0], [0.15, 0.3, 0], 0.07)],
    "an armpit: limbs that run into each other": [capsule([0, 0, 0], [0, 0.35, 0], 0.08),
                                                  capsule([0, 0.3, 0], [0.25, 0.05, 0], 0.05)],
    "thinner than the band": [trimesh.creation.box([0.3, 0.01, 0.2])],
}


def surface_of(meshes):
    mesh = trimesh.util.concatenate(meshes)
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    return Surface(faces, np.zeros((len(vertices), 2), np.float32), faces, vertices), vertices


def inside(vertices, faces, points):
    """By the generalised winding number."""
    return np.asarray(igl.winding_number(vertices.astype(np.float64), faces.astype(np.int64),
                                         points.astype(np.float64))) > 0.5


def distance(points, vertices, faces):
    return np.sqrt(igl.point_mesh_squared_distance(points.astype(np.float64), vertices.astype(np.float64),
                                                   faces.astype(np.int64))[0])


def pierced(vertices, faces, low, cell):
    """Pairs of triangles in one cell of the grid, without a common vertex, one of which has an edge through
    the other."""
    corners = vertices.astype(np.float64)[faces]
    home = np.floor((corners.mean(1) - low) / cell).astype(int)
    _, home = np.unique(home, axis=0, return_inverse=True)
    order = np.argsort(home.ravel(), kind="stable")
    pairs = np.concatenate([np.stack([order[:-k], order[k:]], 1) for k in range(1, 6)])
    pairs = pairs[home.ravel()[pairs[:, 0]] == home.ravel()[pairs[:, 1]]]
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    shared = (faces[pairs[:, 0]][:, :, None] == faces[pairs[:, 1]][:, None]).any((1, 2))
    pairs = pairs[~shared]
    hits = 0
    a, b, c = (corners[pairs[:, 1], i] for i in range(3))
    normal = np.cross(b - a, c - a)
    for i in range(3):
        p, q = corners[pairs[:, 0], i], corners[pairs[:, 0], (i + 1) % 3]
        above, below = ((p - a) * normal).sum(1), ((q - a) * normal).sum(1)
        across = above * below < 0
        x = p + (q - p) * np.where(across, above / np.where(across, above - below, 1), 0)[:, None]
        sides = [(np.cross(v - u, x - u) * normal).sum(1) for u, v in ((a, b), (b, c), (c, a))]
        hits += int((across & np.all([s > 1e-18 for s in sides], axis=0)).sum())
    return hits, len(pairs)


def walking():
    """The default body in the middle of a step, its arms by its sides."""
    body = load_anny()
    return trimesh.Trimesh(pose_sequence(body, load_clip("walk"), [20]).vertices[0], body.faces,
                           process=False)


@pytest.mark.parametrize("name", [*BODIES, pytest.param("the default body, walking", marks=pytest.mark.long)])
def test_shell_is_closed_and_contains_the_band(name):
    surface, posed = surface_of(BODIES[name] if name in BODIES else [walking()])
    vertices, faces = band_shell(surface, mi.Float(posed.ravel()), BAND, CELL, INSIDE)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    assert mesh.area_faces.min() > 0
    low = vertices.min(0)
    hits, compared = pierced(vertices, faces, low - 1.5 * CELL, CELL)
    assert hits == 0 and compared > 100

    rng = np.random.default_rng(3)
    points = rng.uniform(posed.min(0) - BAND, posed.max(0) + BAND, (20000, 3))
    # And close to all of the body: in armpits, between fingers and legs.
    points = np.concatenate([points, band_points(surface, posed, BAND, INSIDE, 20000, seed=3)])
    found = PosedSurface(surface, mi.Float(posed.ravel()),
                         BAND).project(mi.Point3f(points.astype(np.float32).T))
    band = found.valid.numpy() & (found.l.numpy() >= -INSIDE)
    assert band.sum() > 2000
    assert inside(vertices, faces, points[band]).all()

    # What the shell holds beyond the band lies next to it: two cells' diagonals at the very most.
    faces_of_body = surface.faces.numpy().reshape(-1, 3)
    far = distance(points, posed, faces_of_body) > BAND + 2 * np.sqrt(3) * CELL
    assert not inside(vertices, faces, points[far]).any()


def uneven(posed):
    """(V, 2) widths that rise along x from a third of the largest to that."""
    x = posed[:, :1].astype(np.float64)
    return ((1 / 3 + 2 / 3 * (x - x.min()) / np.ptp(x)) * [BAND, INSIDE]).astype(np.float32)


@pytest.mark.parametrize("name", BODIES)
def test_shell_follows_a_band_that_varies(name):
    # Within a triangle, shells take its largest width.
    fine = (trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.05) for mesh in BODIES[name])
    surface, posed = surface_of([trimesh.Trimesh(*mesh) for mesh in fine])
    widths = uneven(posed)
    bands = Bands(surface, widths)
    vertices, faces = band_shell(surface, mi.Float(posed.ravel()), BAND, CELL, INSIDE, bands)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0

    rng = np.random.default_rng(3)
    points = rng.uniform(posed.min(0) - 2 * BAND, posed.max(0) + 2 * BAND, (20000, 3))
    points = np.concatenate([points, band_points(surface, posed, BAND, INSIDE, 20000, seed=3, bands=bands)])
    # The widths of the closest points, by libigl.
    triangles = surface.faces.numpy().reshape(-1, 3).astype(np.int64)
    squared, triangle, on = igl.point_mesh_squared_distance(points, posed.astype(np.float64), triangles)
    corners = posed[triangles[triangle]].astype(np.float64)
    weights = trimesh.triangles.points_to_barycentric(corners, np.asarray(on), method="cramer")
    width = np.einsum("nk,nkd->nd", weights, widths[triangles[triangle]].astype(np.float64))
    within = np.asarray(PosedSurface(surface, mi.Float(posed.ravel()), 1.0).project(
        mi.Point3f(points.astype(np.float32).T)).l) < 0
    band = np.sqrt(squared) < np.where(within, width[:, 1], width[:, 0]) - 1e-5
    assert band.sum() > 2000 and inside(vertices, faces, points[band]).all()

    # Farther than two cells' diagonals from all that any place reaches, nothing is inside. The widths at the
    # closest place vary by less than the widths' slope times a distance.
    slope = 2 / 3 * BAND / np.ptp(posed[:, 0])
    room = 2 * np.sqrt(3) * CELL + slope * 0.05
    far = np.sqrt(squared) > width[:, 0] + slope * BAND + room
    assert far.sum() > 100 and not inside(vertices, faces, points[far]).any()


def test_what_lies_deep_in_the_body_is_left_out():
    surface, posed = surface_of(BODIES["ball"])
    vertices, faces = band_shell(surface, mi.Float(posed.ravel()), BAND, 0.01, INSIDE)
    assert not inside(vertices, faces, np.zeros((1, 3)))[0]
    radii = np.linalg.norm(vertices, axis=1)
    inner = radii[radii < 0.12]
    # Ends no more than the diagonal of a cell and of its part beyond the band.
    assert inner.max() < 0.12 - INSIDE and inner.min() > 0.12 - INSIDE - np.sqrt(3) * 0.01 * 1.5 - 0.004


def test_follows_a_moved_body():
    surface, posed = surface_of(BODIES["limbs a centimetre apart"])
    bent = posed.copy()
    bent[:, 0] += 0.4 * bent[:, 1] ** 2
    vertices, faces = band_shell(surface, mi.Float(bent.ravel()), BAND, CELL, INSIDE)
    points = bent + np.array([0, 0, BAND - 1e-3])
    found = PosedSurface(surface, mi.Float(bent.ravel()),
                         BAND).project(mi.Point3f(points.astype(np.float32).T))
    band = found.valid.numpy() & (found.l.numpy() >= -INSIDE)
    assert band.sum() > 0.4 * len(points)
    assert inside(vertices, faces, points[band]).all()


def test_any_set_of_nodes_gives_a_closed_mesh_around_whole_cells():
    """Checkerboards and noise are the hard cases of marching cubes."""
    rng = np.random.default_rng(5)
    for trial in range(12):
        nodes = np.zeros((9, 9, 9), dtype=bool)
        nodes[1:-1, 1:-1, 1:-1] = rng.random((7, 7, 7)) < (0.1, 0.3, 0.5, 0.8)[trial % 4]
        if trial == 11:
            nodes[1:-1, 1:-1, 1:-1] = np.indices((7, 7, 7)).sum(0) % 2
        grid = Grid(np.array([1.0, -2.0, 0.5]), 0.1, (8, 8, 8))
        vertices, faces = cut(nodes, rng.normal(size=nodes.shape), grid)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        assert mesh.is_watertight and mesh.is_winding_consistent, trial
        assert mesh.volume > 0
        # Random points of cells with all corners inside are inside; of cells with none, outside; nodes on
        # their own side.
        count = np.zeros((8, 8, 8), int)
        for shift in np.ndindex(2, 2, 2):
            count += nodes[shift[0] : shift[0] + 8, shift[1] : shift[1] + 8, shift[2] : shift[2] + 8]
        for cells, expected in ((count == 8, True), (count == 0, False)):
            at = np.argwhere(cells)
            if len(at):
                assert (inside(vertices, faces,
                               grid.low + (at + rng.random((len(at), 3))) * grid.cell) == expected).all()
        places = np.argwhere(np.ones_like(nodes))
        assert (inside(vertices, faces, grid.low + places * grid.cell) == nodes.ravel()).all()
        hits, _ = pierced(vertices, faces, grid.low, grid.cell)
        assert hits == 0


def test_grids_are_combined_as_by_brute_force():
    rng = np.random.default_rng(2)
    parts = rng.random((8, 6, 10)).astype(np.float32)
    assert reduce_parts(parts,
                        np.maximum) == pytest.approx(parts.reshape(4, 2, 3, 2, 5, 2).max(axis=(1, 3, 5)))
    assert reduce_parts(parts, np.add) == pytest.approx(parts.reshape(4, 2, 3, 2, 5, 2).sum(axis=(1, 3, 5)))
    wide = np.pad(parts, 1)
    expected = np.max([wide[i : i + 8, j : j + 6, k : k + 10] for i, j, k in np.ndindex(3, 3, 3)], axis=0)
    assert (spread(parts) == expected).all()
    nodes = np.max([np.pad(parts, 1)[i : i + 9, j : j + 7, k : k + 11] for i, j, k in np.ndindex(2, 2, 2)],
                   axis=0)
    assert (corners_of(parts) == nodes).all()
