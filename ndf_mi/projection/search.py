"""The search for the closest triangle: a complete binary tree walked without a stack, in evaluated and symbolic code alike.

Lengths are in the tree's own units (see :class:`ndf_mi.projection.surface.PosedSurface`): 65535 along the longest side
of the mesh's box. Nothing here is differentiated.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

UNITS = 65535
WORDS = 6
"""Words of an internal node: for its two children, three words of (upper bound << 16) | lower bound, one an axis."""


def box_distance2(words: list[mi.UInt32], q: mi.Point3f) -> mi.Float:
    """Squared distance from ``q`` to the box in three words."""
    total = mi.Float(0)
    for word, x in zip(words, q, strict=True):
        outside = dr.maximum(dr.maximum(mi.Float(word & 0xFFFF) - x, x - mi.Float(word >> 16)), 0)
        total = dr.fma(outside, outside, total)
    return total


def _segment(q: mi.Vector3f, edge: mi.Vector3f, along: mi.Float, length2: mi.Float) -> mi.Float:
    """Squared distance from ``q`` to the segment from 0 to ``edge``, where ``along`` is their dot product."""
    t = dr.clip(along / dr.maximum(length2, 1e-20), 0, 1)
    return dr.squared_norm(q - edge * t)


def pair_distance2(corners: list[mi.Float], q: mi.Point3f) -> tuple[mi.Float, mi.Float]:
    """Squared distances from ``q`` to the triangles (a, b, c) and (a, c, d), whose 12 coordinates are ``corners``."""
    a, b, c, d = (mi.Vector3f(*corners[3 * i : 3 * i + 3]) for i in range(4))
    q, b, c, d = mi.Vector3f(q) - a, b - a, c - a, d - a
    qb, qc, qd = dr.dot(q, b), dr.dot(q, c), dr.dot(q, d)
    bb, cc, dd = dr.dot(b, b), dr.dot(c, c), dr.dot(d, d)
    bc, cd = dr.dot(b, c), dr.dot(c, d)
    diagonal = _segment(q, c, qc, cc)

    def triangle(e: mi.Vector3f, qe: mi.Float, ee: mi.Float, ec: mi.Float) -> mi.Float:
        s, t, area2 = qe * cc - qc * ec, qc * ee - qe * ec, ee * cc - ec * ec
        rest = c - e
        border = dr.minimum(
            dr.minimum(diagonal, _segment(q, e, qe, ee)), _segment(q - e, rest, qc - qe - ec + ee, cc - 2 * ec + ee)
        )
        # a sliver's area is rounding; its border alone then gives the distance
        inside = (s >= 0) & (t >= 0) & (s + t <= area2) & (area2 > 1e-6 * ee * cc)
        scale = 1 / dr.select(inside, area2, 1)
        return dr.select(inside, dr.squared_norm(q - e * (s * scale) - c * (t * scale)), border)

    return triangle(b, qb, bb, bc), triangle(d, qd, dd, cd)


def closest_pair(
    nodes: mi.UInt32,
    corners: mi.Float,
    leaves: int,
    q: mi.Point3f,
    bound2: mi.Float,
    seed: mi.UInt32 | None,
    active: mi.Bool,
) -> tuple[mi.Float, mi.UInt32]:
    """Walks the tree nearest child first; pending siblings are bits of one word, as the tree is complete.

    After Áfra and Szirmay-Kalos, "Stackless Multi-BVH Traversal for CPU, MIC and GPU Ray Tracing" (2014), for distances.

    Args:
        nodes: (leaves * 6) words: the boxes of the children of node n from 6 n on.
        corners: (leaves * 12) coordinates of the leaves' pairs.
        leaves: their number, a power of two.
        q: the queries.
        bound2: squared distance beyond which nothing is looked for.
        seed: a leaf to test before the others, in active lanes; the better it is, the less is walked.
        active: lanes that search.

    Returns:
        the squared distance of the best triangle, or ``bound2`` where there is none within; and its number 2 · leaf +
        (0 or 1), or 2 · leaves where there is none.
    """

    def test(node: mi.UInt32, best: mi.Float, found: mi.UInt32, at_leaf: mi.Bool) -> tuple[mi.Float, mi.UInt32]:
        leaf = node & (leaves - 1)
        values = [dr.gather(mi.Float, corners, leaf * 12 + k, at_leaf) for k in range(12)]
        for k, d2 in enumerate(pair_distance2(values, q)):
            better = at_leaf & (d2 < best)
            best = dr.select(better, d2, best)
            found = dr.select(better, 2 * leaf + k, found)
        return best, found

    def pop(node: mi.UInt32, trail: mi.UInt32, mask: mi.Bool) -> tuple[mi.UInt32, mi.UInt32]:
        done = trail == 0
        up = dr.select(done, 0, dr.tzcnt(trail))
        return (
            dr.select(mask, dr.select(done, 0, (node >> up) ^ 1), node),
            dr.select(mask, dr.select(done, 0, (trail >> up) ^ 1), trail),
        )

    def descend(node: Any, trail: Any, best: Any, found: Any) -> tuple[Any, Any, Any, Any]:
        words = [dr.gather(mi.UInt32, nodes, node * WORDS + k) for k in range(WORDS)]
        left, right = box_distance2(words[:3], q), box_distance2(words[3:], q)
        near_right = right < left
        nearest, farthest = dr.minimum(left, right), dr.maximum(left, right)
        hit, both = nearest < best, farthest < best
        below = 2 * node + dr.select(near_right, 1, 0)
        trail = dr.select(hit, 2 * trail + dr.select(both, 1, 0), trail)
        node, trail = pop(dr.select(hit, below, node), trail, ~hit)
        return node, trail, best, found

    def step(node: Any, trail: Any, best: Any, found: Any) -> tuple[Any, Any, Any, Any]:
        node, trail, best, found = dr.while_loop(
            (node, trail, best, found), lambda n, *_: (n != 0) & (n < leaves), descend, label="closest: descend"
        )
        at_leaf = node >= leaves
        best, found = test(node, best, found, at_leaf)
        node, trail = pop(node, trail, at_leaf)
        return node, trail, best, found

    best, found = mi.Float(bound2), mi.UInt32(2 * leaves)
    if seed is not None:
        best, found = test(seed, best, found, active)
    start = dr.select(active, mi.UInt32(1), mi.UInt32(0))
    _, _, best, found = dr.while_loop((start, mi.UInt32(0), best, found), lambda n, *_: n != 0, step, label="closest")
    return best, found
