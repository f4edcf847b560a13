"""The search for the closest triangle: a complete binary tree walked without a stack, in evaluated and
symbolic code alike.

Lengths are in the tree's own units (:class:`ndf_mi.projection.refit.Frame`). Nothing here is differentiated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi

WORDS = 8
"""Words of an internal node: three words of (upper bound << 16) | lower bound, one an axis, for each of two
children. Two stay empty, as aligned words are read four at a time."""


State: TypeAlias = "tuple[mi.UInt32, mi.UInt32, mi.Float, mi.UInt32]"
"""Node, trail, squared distance of the best triangle and its number."""


@dataclass(frozen=True)
class Boxes:
    """The tree in one pose.

    Attributes:
        nodes: (leaves * 8) words; those of node n, root 1, children 2n and 2n + 1, from 8 n on.
        corners: (leaves * 12) coordinates of the leaves' vertices a, b, c, d for triangles (a, b, c) and (a,
            c, d).
        depth: leaf i is node ``leaves + i`` with ``leaves = 2 ** depth``.
    """

    nodes: mi.UInt32
    corners: mi.Float
    depth: int

    @property
    def leaves(self) -> int:
        """Number of leaves."""
        return 1 << self.depth

    def children(self, node: mi.UInt32) -> tuple[list[mi.UInt32], list[mi.UInt32]]:
        """The boxes of the children of an internal node, three words each."""
        words = _read4(self.nodes, 2 * node) + _read4(self.nodes, 2 * node + 1)
        return words[:3], words[3:6]


def _read4(array: mi.Float | mi.UInt32, index: mi.UInt32) -> list[mi.Float]:
    """Four adjacent values, the first at 4 · index, by one packet load."""
    return list(dr.gather(mi.Vector4f if isinstance(array, mi.Float) else mi.Vector4u, array, index))


def larger(a: mi.Float, b: mi.Float | float) -> mi.Float:
    """One instruction, where ``dr.maximum`` spends several on NaN."""
    return dr.select(a > b, a, b)


def smaller(a: mi.Float, b: mi.Float | float) -> mi.Float:
    """As :func:`larger`."""
    return dr.select(a < b, a, b)


def box_distance2(words: list[mi.UInt32], q: mi.Point3f, reach: mi.Float | float = 0) -> mi.Float:
    """Squared distance from a cube about ``q``, of half side ``reach``, to the box in three words."""
    total = mi.Float(0)
    for word, x in zip(words, q, strict=True):
        outside = larger(mi.Float(word & 0xFFFF) - x, x - mi.Float(word >> 16))
        outside = larger(outside - reach, 0)
        total = dr.fma(outside, outside, total)
    return total


def _segment(q: mi.Vector3f, edge: mi.Vector3f, along: mi.Float, length2: mi.Float) -> mi.Float:
    """Squared distance from ``q`` to the segment from 0 to ``edge``, where ``along`` is their dot product."""
    t = smaller(larger(along * dr.rcp(larger(length2, 1e-20)), 0), 1)
    return dr.squared_norm(q - edge * t)


def pair_distance2(corners: list[mi.Float], q: mi.Point3f) -> tuple[mi.Float, mi.Float]:
    """Squared distances from ``q`` to the triangles (a, b, c) and (a, c, d), whose 12 coordinates are
    ``corners``."""
    a, b, c, d = (mi.Vector3f(*corners[3 * i : 3 * i + 3]) for i in range(4))
    q, b, c, d = mi.Vector3f(q) - a, b - a, c - a, d - a
    qc, cc = dr.dot(q, c), dr.dot(c, c)
    inverse = dr.rcp(larger(cc, 1e-20))
    along = qc * inverse
    rejected = q - c * along
    diagonal = dr.squared_norm(q - c * smaller(larger(along, 0), 1))

    def triangle(e: mi.Vector3f) -> mi.Float:
        qe, ee, ec = dr.dot(q, e), dr.dot(e, e), dr.dot(e, c)
        third = _segment(q - e, c - e, qc - qe - ec + ee, cc - 2 * ec + ee)
        border = smaller(smaller(diagonal, _segment(q, e, qe, ee)), third)
        # The parts of the edge and of q orthogonal to the diagonal, as in closest_on_triangle.
        share = ec * inverse
        height = e - c * share
        height2 = dr.squared_norm(height)
        t = dr.dot(rejected, height) * dr.rcp(larger(height2, 1e-20))
        s = along - share * t
        # The height of a sliver is rounding: its border alone then gives the distance.
        inside = (s >= 0) & (t >= 0) & (s + t <= 1) & (height2 > 1e-12 * ee)
        return dr.select(inside, dr.squared_norm(rejected - height * t), border)

    return triangle(b), triangle(d)


def _pop(node: mi.UInt32, trail: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32]:
    """The sibling of the lowest ancestor that has one pending; node 0 where none has."""
    done = trail == 0
    up = dr.select(done, 0, dr.tzcnt(trail))
    return dr.select(done, 0, (node >> up) ^ 1), dr.select(done, 0, (trail >> up) ^ 1)


def closest_pair(
    boxes: Boxes, q: mi.Point3f, bound2: mi.Float, node: mi.UInt32, trail: mi.UInt32, slack: float = 0
) -> tuple[mi.Float, mi.UInt32]:
    """Walks the tree from ``node``, the nearer child first. As the tree is complete, pending siblings are
    bits of a word (after Áfra and Szirmay-Kalos, "Stackless Multi-BVH Traversal for CPU, MIC and GPU Ray
    Tracing", 2014).

    Args:
        bound2: squared distance beyond which nothing is searched.
        node: where to begin: the root, or a leaf that is likely to be close, which is tested first. 0 in
            lanes without a query.
        trail: bit i is set where the sibling of ``node >> i`` is to be visited as well.
        slack: s > 0 accepts a triangle up to 1 + s times as far as the closest one, but never misses one
            within the bound.

    Returns:
        the squared distance of the best triangle, or ``bound2`` where none is within; and its number 2 · leaf
        + (0 or 1), or 2 · leaves where there is none.
    """
    leaves = boxes.leaves

    def leaf(node: mi.UInt32, trail: mi.UInt32, best: mi.Float, found: mi.UInt32) -> State:
        index = node - leaves
        corners = [value for k in range(3) for value in _read4(boxes.corners, index * 3 + k)]
        for k, distance2 in enumerate(pair_distance2(corners, q)):
            better = distance2 < best
            best, found = dr.select(better, distance2, best), dr.select(better, 2 * index + k, found)
        node, trail = _pop(node, trail)
        return node, trail, best, found

    def step(node: mi.UInt32, trail: mi.UInt32, best: mi.Float, found: mi.UInt32) -> State:
        node, trail, best, found = dr.if_stmt(
            (node, trail, best, found), node >= leaves, leaf, lambda *state: state, label="closest: leaf"
        )
        inner = (node != 0) & (node < leaves)
        left, right = (box_distance2(words, q) for words in boxes.children(dr.select(inner, node, 1)))
        limit = best if slack == 0 else dr.select(found < 2 * leaves, best / (1 + slack) ** 2, best)
        hit, both = inner & (smaller(left, right) < limit), inner & (larger(left, right) < limit)
        below = 2 * node + dr.select(right < left, 1, 0)
        node, trail = dr.select(hit, below, node), dr.select(hit, 2 * trail + dr.select(both, 1, 0), trail)
        popped = _pop(node, trail)
        miss = inner & ~hit
        return dr.select(miss, popped[0], node), dr.select(miss, popped[1], trail), best, found

    state = (node, trail, mi.Float(bound2), dr.full(mi.UInt32, 2 * leaves))
    _, _, best, found = dr.while_loop(state, lambda node, *_: node != 0, step, label="closest")
    return best, found


def any_within(
    boxes: Boxes, q: mi.Point3f, reach: mi.Float, scale: mi.Float, extra: mi.Float, node: mi.UInt32,
    trail: mi.UInt32,
) -> mi.Bool:
    """Whether some triangle is within the distance that its own leaf allows.

    Args:
        reach: for each node, the largest distance that a leaf below it allows.
        scale: factor on `reach`.
        extra: added to all distances.
        node, trail: where to begin, as in :func:`closest_pair`.
    """
    leaves = boxes.leaves

    def limit2(node: mi.UInt32) -> mi.Float:
        return dr.square(dr.fma(dr.gather(mi.Float, reach, node), scale, extra))

    def leaf(node: mi.UInt32, trail: mi.UInt32, found: mi.Bool) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
        corners = [value for k in range(3) for value in _read4(boxes.corners, (node - leaves) * 3 + k)]
        within = smaller(*pair_distance2(corners, q)) <= limit2(node)
        node, trail = _pop(node, trail)
        return dr.select(within, 0, node), trail, found | within

    def step(node: mi.UInt32, trail: mi.UInt32, found: mi.Bool) -> tuple[mi.UInt32, mi.UInt32, mi.Bool]:
        node, trail, found = dr.if_stmt(
            (node, trail, found), node >= leaves, leaf, lambda *state: state, label="any within: leaf"
        )
        inner = (node != 0) & (node < leaves)
        parent = dr.select(inner, node, 1)
        left, right = (box_distance2(words, q) for words in boxes.children(parent))
        to_left, to_right = left <= limit2(2 * parent), right <= limit2(2 * parent + 1)
        hit, both = inner & (to_left | to_right), to_left & to_right
        below = 2 * node + dr.select(to_right & (~to_left | (right < left)), 1, 0)
        popped = _pop(node, trail)
        miss = inner & ~hit
        node, trail = dr.select(hit, below, node), dr.select(hit, 2 * trail + dr.select(both, 1, 0), trail)
        return dr.select(miss, popped[0], node), dr.select(miss, popped[1], trail), found

    state = (node, trail, dr.full(mi.Bool, False, dr.width(node)))
    return dr.while_loop(state, lambda node, *_: node != 0, step, label="any within")[2]


def pending(boxes: Boxes, q: mi.Point3f, reach: mi.Float, leaf: mi.UInt32, bound: mi.Float) -> mi.UInt32:
    """The trail with which every search from the cube of half side ``reach`` about ``q`` can begin at
    ``leaf``: bit i is set where the sibling of the leaf's ancestor i levels up is within ``bound``."""
    trail, node = mi.UInt32(0), leaf + boxes.leaves
    for level in range(boxes.depth):
        left, right = boxes.children(node >> 1)
        is_left = (node & 1) == 0
        sibling = [dr.select(is_left, b, a) for a, b in zip(left, right, strict=True)]
        trail |= dr.select(box_distance2(sibling, q, reach) <= bound * bound, 1 << level, 0)
        node = node >> 1
    return trail
