"""What a pose changes: the search tree's boxes, the units that they are written in, and normals."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.projection.local import unit
from ndf_mi.projection.search import WORDS, Boxes
from ndf_mi.projection.surface import Surface

UNITS = 65535
"""Units along the longest side of the posed mesh's box."""

HEIGHT = 3
"""Levels of the tree that one kernel merges."""


class Frame:
    """The search's coordinates: relative to the box of the posed mesh, ``UNITS`` along its longest side.

    Boxes then fit 16 bits a bound, rounded outwards, and no precision is lost far from the world's origin.
    """

    def __init__(self, low: np.ndarray, high: np.ndarray, band: float) -> None:
        side = max(float((high - low).max()), 1e-3 * band)
        self.origin = mi.Point3f(*(dr.opaque(mi.Float, float(c)) for c in low))
        # Slightly less than fits, as the scaling rounds.
        self.scale = dr.opaque(mi.Float, UNITS * (1 - 1e-6) / side)

    def to_units(self, x: mi.Point3f) -> mi.Point3f:
        """World to search coordinates."""
        return mi.Point3f((x - self.origin) * self.scale)


def refit(surface: Surface, vertices: mi.Float, frame: Frame) -> Boxes:
    """Boxes of all nodes and coordinates of all leaves, for the search."""
    leaves = surface.leaves
    leaf = dr.arange(mi.UInt32, leaves)
    corners = dr.empty(mi.Float, 12 * leaves)
    low, high = mi.Point3f(UNITS), mi.Point3f(0)
    for k in range(4):
        vertex = dr.gather(mi.UInt32, surface.leaf_corners, 4 * leaf + k)
        point = frame.to_units(dr.gather(mi.Point3f, vertices, vertex))
        dr.scatter(corners, point, 4 * leaf + k)
        low, high = dr.minimum(low, point), dr.maximum(high, point)
    low = dr.select(surface.leaf_occupied, dr.clip(dr.floor(low), 0, UNITS), UNITS)
    high = dr.select(surface.leaf_occupied, dr.clip(dr.ceil(high), 0, UNITS), 0)
    words = [mi.UInt32(low[k]) | (mi.UInt32(high[k]) << 16) for k in range(3)]
    nodes = dr.zeros(mi.UInt32, WORDS * leaves)
    dr.eval(corners, words, nodes)
    level = surface.depth
    while level > 0:
        height = min(level, HEIGHT)
        words = _merge(nodes, words, dr.opaque(mi.UInt32, 1 << (level - height)), height)
        level -= height
        dr.eval(nodes, words)
    return Boxes(nodes, corners, surface.depth)


def _merge(nodes: mi.UInt32, words: list[mi.UInt32], first: mi.UInt32, height: int) -> list[mi.UInt32]:
    """Writes the nodes of ``height`` levels, given the boxes of the level below; returns the boxes of the
    highest, whose first node is ``first``. Each lane merges one of its nodes and the nodes below it."""
    lane = dr.arange(mi.UInt32, dr.width(words[0]) >> height)
    below = [[dr.gather(mi.UInt32, w, (lane << height) + i) for w in words] for i in range(1 << height)]
    for up in range(height - 1, -1, -1):
        merged = []
        for i in range(1 << up):
            left, right = below[2 * i], below[2 * i + 1]
            node = ((first + lane) << up) + i
            dr.scatter(nodes, mi.Vector4u(*left, right[0]), 2 * node)
            dr.scatter(nodes, mi.Vector4u(*right[1:], 0, 0), 2 * node + 1)
            merged.append([_union(a, b) for a, b in zip(left, right, strict=True)])
        below = merged
    return below[0]


def _union(a: mi.UInt32, b: mi.UInt32) -> mi.UInt32:
    return dr.minimum(a & 0xFFFF, b & 0xFFFF) | dr.maximum(a & 0xFFFF0000, b & 0xFFFF0000)


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
