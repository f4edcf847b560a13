"""Blend weights at points around a body, and skinning of such points with them, forward and inverse.

    x = A·x_c + t,    (A | t) = Σ_j w_j G_j

G_j are the joints' transforms from rest to world space, w the blend weights of the point, x_c its place
around the body at rest: the canonical space.

Weights of N points are tensors of shape (J, N), and what mixes joints is a matrix product: some thirty joints
a lane would fill the kernels otherwise. For evaluated code.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.projection import Surface, aligned

LEAST_DETERMINANT = 1e-3
"""Points whose blended matrix has a smaller determinant have no canonical place: joints that turn against
each other crush the space between them. A rotation has the determinant 1."""


LARGEST_CORRECTION = 40.0
"""Largest magnitude of a correction Δ that counts: it turns any weight into almost 0 or 1."""


class BodyWeights:
    """The body's own blend weights at points of its triangles.

    Args:
        weights: (V, J) skinning weights, rows sum to 1.
        surface: the body's triangles.

    Attributes:
        joints: J.
    """

    def __init__(self, weights: np.ndarray, surface: Surface) -> None:
        self.joints = weights.shape[1]
        self._flat = aligned(mi.Float(np.ascontiguousarray(weights, np.float32).ravel()))
        self._surface = surface

    def at(self, triangle: mi.UInt32, barycentric: mi.Point3f, active: mi.Bool) -> mi.TensorXf:
        """(J, N) weights, attached to the barycentric coordinates; zero in inactive lanes."""
        count = dr.width(triangle)
        lane = dr.arange(mi.UInt32, self.joints * count)
        joint = lane // count
        point = lane - joint * count
        total = mi.Float(0)
        for k in range(3):
            corner = dr.gather(mi.UInt32, self._surface.faces, 3 * triangle + k, active) * self.joints
            share = dr.select(active, barycentric[k], 0.0)
            dr.eval(corner, share)
            own = dr.gather(mi.Float, self._flat, dr.gather(mi.UInt32, corner, point) + joint)
            if dr.grad_enabled(share):
                # The derivative of a gather would be a scatter with many collisions.
                wide = (_ones(self.joints, 1) @ mi.TensorXf(share, (1, count))).array
            else:
                wide = dr.gather(mi.Float, share, point)
            total = dr.fma(own, wide, total)
        return mi.TensorXf(total, (self.joints, count))


def neural_weights(body: mi.TensorXf, delta: mi.TensorXf) -> mi.TensorXf:
    """softmax(log(w_body + 1e-9) + Δ): the body's weights, (J, N), corrected by a network. They are finite
    and sum to 1 whatever Δ is."""
    delta = dr.clip(delta, -LARGEST_CORRECTION, LARGEST_CORRECTION)
    # Within e^±61, so that nothing need be subtracted.
    exponentials = dr.exp(dr.log(body + 1e-9) + delta)
    joints = body.shape[0]
    return exponentials * (_ones(joints, 1) @ dr.rcp(_ones(1, joints) @ exponentials))


def smooth_l1(a: mi.TensorXf, b: mi.TensorXf) -> mi.Float:
    """The smooth-L1 distance of N points' blend weights, mean over the joints. Weights differ by at most 1,
    where it is half the square."""
    joints = a.shape[0]
    return (_ones(1, joints) @ dr.square(a - b)).array * (0.5 / joints)


def every(weights: mi.TensorXf, step: int) -> mi.TensorXf:
    """The weights of every `step`-th point."""
    joints, count = weights.shape
    kept = count // step
    lane = dr.arange(mi.UInt32, joints * kept)
    joint = lane // kept
    index = joint * count + (lane - joint * kept) * step
    found = dr.gather(mi.Float, weights.array, index, mode=dr.ReduceMode.NoConflicts)
    return mi.TensorXf(found, (joints, kept))


def _ones(rows: int, columns: int) -> mi.TensorXf:
    return dr.full(mi.TensorXf, 1.0, (rows, columns))


class Blended:
    """The blended transforms Σ_j w_j G_j of N points.

    Args:
        transforms: flat (J·12), each joint's transform from rest to world space, row by row, as
            `JointTransforms.matrices`.
        weights: (J, N). Gradients flow to them.
    """

    def __init__(self, transforms: mi.Float, weights: mi.TensorXf) -> None:
        joints, count = weights.shape
        lane = dr.arange(mi.UInt32, 12 * joints)
        entry = lane // joints
        matrix = dr.gather(mi.Float, transforms, 12 * (lane - entry * joints) + entry)
        blended = (mi.TensorXf(matrix, (12, joints)) @ weights).array
        lane = dr.arange(mi.UInt32, count)
        entries = [dr.gather(mi.Float, blended, lane + k * count) for k in range(12)]
        self._matrix = mi.Matrix3f(*[entries[4 * row + column] for row in range(3) for column in range(3)])
        self._shift = mi.Vector3f(*[entries[4 * row + 3] for row in range(3)])

    def forward(self, canonical: mi.Point3f) -> mi.Point3f:
        """Points around the body at rest to world space."""
        return mi.Point3f(self._matrix @ mi.Vector3f(canonical) + self._shift)

    def inverse(self, world: mi.Point3f) -> tuple[mi.Point3f, mi.Bool]:
        """Points in world space to where they are around the body at rest, and whether there is such a place
        (:data:`LEAST_DETERMINANT`); the others are finite."""
        m = self._matrix
        a, b, c = (mi.Vector3f(m[i, 0], m[i, 1], m[i, 2]) for i in range(3))
        columns = dr.cross(b, c), dr.cross(c, a), dr.cross(a, b)
        determinant = dr.dot(a, columns[0])
        exists = dr.detach(determinant) > LEAST_DETERMINANT
        offset = (mi.Vector3f(world) - self._shift) / dr.select(exists, determinant, 1.0)
        place = columns[0] * offset.x + columns[1] * offset.y + columns[2] * offset.z
        return mi.Point3f(place), exists
