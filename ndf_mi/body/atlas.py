"""A one-piece atlas for any body: cut along a seam and flattened into one chart.

A surface with several connected components gets a chart for each, side by side in the unit square at one
scale. Flattening needs the extra ``atlas``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
import trimesh

from ndf_mi.body import arrays, atlas_flatten
from ndf_mi.body import atlas_mesh as mesh
from ndf_mi.body.atlas_check import Atlas, AtlasReport, check_atlas, overlapping
from ndf_mi.body.atlas_pack import pack
from ndf_mi.body.atlas_seam import choose_seam
from ndf_mi.body.body import Body
from ndf_mi.errors import InputError

__all__ = ["Atlas", "AtlasReport", "check_atlas", "one_piece", "with_one_piece"]

FRONT = (0.0, 0.0, 1.0)
"""The direction in which bodies face at rest."""

_GRID = 2.0**24
_LEAST_AREA = 1e-12


def one_piece(vertices: np.ndarray, faces: np.ndarray, front: Sequence[float] = FRONT) -> Atlas:
    """Cuts a surface open and flattens it: a chart for each component, without flips and overlaps.

    The same input gives the same atlas. Coordinates are multiples of 2⁻²⁴, for which `check_atlas` is exact.
    It takes about 20 seconds for 27,000 triangles.

    Args:
        vertices: (V, 3), any unit; those without a triangle are ignored.
        faces: (F, 3) int32, consistently oriented. Boundaries and handles are allowed.
        front: (3,), the direction in which the body faces: seams prefer its back.

    Raises:
        InputError: numbers are not finite, indices out of range, or a triangle has no area (below 10⁻¹² of
            the whole); the surface is not an oriented manifold, or cannot be flattened without flips or
            overlaps; or the extra ``atlas`` is not installed.
    """
    points = arrays.floats("vertices", vertices, (None, 3)).astype(np.float64)
    triangles = arrays.indices("faces", faces, (None, 3), 0, len(points)).astype(np.int64)
    if len(triangles) == 0:
        raise InputError("faces", "no triangle", "at least one")
    facing = arrays.floats("front", np.asarray(front), (3,)).astype(np.float64)
    if not facing.any():
        raise InputError("front", "a zero vector", "a direction")
    facing /= np.linalg.norm(facing)
    opposite = mesh.opposites(triangles)
    areas = trimesh.triangles.area(points[triangles])
    if areas.min() <= _LEAST_AREA * areas.sum():
        thin = int(np.argmin(areas))
        found = f"triangle {thin} with the area {areas[thin]:.3g} of {areas.sum():.3g}"
        raise InputError("vertices", found, "triangles with an area", "Use another pose, or repair the mesh.")

    charts, uv_faces, first = [], np.zeros_like(triangles), 0
    component = mesh.components(opposite)
    for number in range(component.max() + 1):
        mine = np.nonzero(component == number)[0]
        flat, corners = _chart(points, triangles[mine], facing)
        charts.append(flat)
        uv_faces[mine] = corners + first
        first += len(flat)
    uv = np.round(pack(charts) * _GRID) / _GRID
    atlas = Atlas(uv.astype(np.float32), uv_faces.astype(np.int32))
    report = check_atlas(points, triangles, atlas)
    if not report.valid:
        found = (f"{report.charts} charts of {report.components} components, {report.flipped} flipped "
                 f"triangles and {report.overlaps} overlaps")
        raise InputError("vertices", f"a surface whose atlas has {found}", "a surface that can be flattened",
                         "Refine or smooth its mesh.")
    return atlas


def with_one_piece(body: Body, vertices: np.ndarray | None = None, front: Sequence[float] = FRONT) -> Body:
    """The body with a one-piece atlas instead of its own texture coordinates.

    Args:
        body: any body; all fields but ``uv`` and ``uv_faces`` are kept.
        vertices: (V, 3), the pose that is flattened, with arms and legs apart; by default the template.
        front: the direction in which the body faces in that pose.

    Raises:
        InputError: the body has no template and no vertices are given; or as `one_piece`.
    """
    vertices = body.template if vertices is None else vertices
    if vertices is None:
        raise InputError("body", "no template", "rest vertices, or the vertices of a pose")
    atlas = one_piece(vertices, body.faces, front)
    return dataclasses.replace(body, uv=atlas.uv, uv_faces=atlas.uv_faces)


def _chart(points: np.ndarray, triangles: np.ndarray, front: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Flattens one component: (U, 2) float64 at the scale of the surface, and (F, 3) indices into it."""
    opposite = mesh.opposites(triangles)
    # A vertex where the surface only touches itself becomes several in the plane.
    faces, own = _split(triangles, points, opposite, np.zeros(triangles.size, bool))
    cut = choose_seam(own, faces, opposite, front)
    corners, opened = _split(faces, own, opposite, cut)
    for flat in reversed(list(_attempts(opened, corners))):
        if _rounds_well(flat, corners):
            return flat, corners
    found = f"{len(triangles)} triangles that no map onto a disk flattens"
    raise InputError("vertices", found, "a surface without extremely thin or small triangles",
                     "Refine or smooth its mesh.")


def _split(
    faces: np.ndarray, points: np.ndarray, opposite: np.ndarray, cut: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The triangles over the vertices after cutting, and those vertices."""
    corners = mesh.vertices_after_cut(opposite, cut)
    source = np.zeros(corners.max() + 1, np.int64)
    source[corners.ravel()] = faces.ravel()
    return corners, points[source]


def _attempts(points: np.ndarray, faces: np.ndarray) -> Iterator[np.ndarray]:
    """Flat maps, each with less distortion than the one before; the first cannot overlap."""
    flat = atlas_flatten.start(points, faces)
    if flat is not None:
        yield flat
        yield from atlas_flatten.relaxed(points, faces, flat)


def _rounds_well(flat: np.ndarray, corners: np.ndarray) -> bool:
    """Whether the chart, rounded to the grid of 2⁻²⁴, has neither flips nor overlaps."""
    if not np.isfinite(flat).all():
        return False
    unit = np.round(pack([flat]) * _GRID) / _GRID
    if trimesh.triangles.cross(unit[corners]).min() <= 0:
        return False
    return len(overlapping(unit[corners])) == 0
