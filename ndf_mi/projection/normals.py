"""Face normals and pseudonormals of a posed mesh, which decide the sign of the distance."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ndf_mi.projection.local import unit
from ndf_mi.projection.surface import Surface


def face_normals(surface: Surface, vertices: mi.Float) -> mi.Float:
    """Flat (3·F) unit normals; zero for a triangle without area."""
    triangle = dr.arange(mi.UInt32, surface.face_count)
    v0, v1, v2 = _corners(surface, vertices, triangle)
    # Scaled first: the squared area of a triangle of a millimetre is close to the smallest float.
    e1, e2 = v1 - v0, v2 - v0
    longest = dr.maximum(dr.maximum(dr.max(dr.abs(e1)), dr.max(dr.abs(e2))), 1e-20)
    normal = unit(dr.cross(e1 / longest, e2 / longest), mi.Vector3f(0))
    return _flat(normal, surface.face_count, triangle)


def vertex_normals(surface: Surface, vertices: mi.Float, normals: mi.Float) -> mi.Float:
    """Flat (3·V) unit pseudonormals: the face normals around a vertex, weighted by their angles there."""
    triangle = dr.arange(mi.UInt32, surface.face_count)
    points = _corners(surface, vertices, triangle)
    normal = dr.gather(mi.Point3f, normals, triangle)
    total = dr.zeros(mi.Float, 3 * surface.vertex_count)
    for k in range(3):
        to_next, to_last = points[(k + 1) % 3] - points[k], points[(k + 2) % 3] - points[k]
        angle = dr.atan2(dr.norm(dr.cross(to_next, to_last)), dr.dot(to_next, to_last))
        vertex = dr.gather(mi.UInt32, surface.faces, 3 * triangle + k)
        for axis in range(3):
            dr.scatter_add(total, angle * normal[axis], 3 * vertex + axis)
    vertex = dr.arange(mi.UInt32, surface.vertex_count)
    pseudonormal = unit(mi.Vector3f(dr.gather(mi.Point3f, total, vertex)), mi.Vector3f(0))
    return _flat(pseudonormal, surface.vertex_count, vertex)


def _corners(surface: Surface, vertices: mi.Float, triangle: mi.UInt32) -> list[mi.Point3f]:
    index = [dr.gather(mi.UInt32, surface.faces, 3 * triangle + k) for k in range(3)]
    return [dr.gather(mi.Point3f, vertices, i) for i in index]


def _flat(vectors: mi.Vector3f, count: int, index: mi.UInt32) -> mi.Float:
    flat = dr.empty(mi.Float, 3 * count)
    dr.scatter(flat, vectors, index)
    dr.eval(flat)
    return flat
