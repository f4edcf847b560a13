"""Linear blend skinning in Dr.Jit, with gradients of pose, root rotation, translation and shape.

With rest joints J_j(β) and rest vertices T_i(β, θ) = T̄_i + B_S(β)_i + B_P(θ)_i (Loper et al. 2015, SMPL,
eqs. 2-8):

    G_j = G_parent(j) · [R(θ_j) | J_j - J_parent(j)],   X_i = Σ_j w_ij G_j · (T_i - J_j),   V_i = R(root)·X_i
    + t

R(root) turns about the world's origin (ZJU-MoCap's convention), not about the root joint. Skinning weights
and blend shapes get no gradient.
"""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.body.body import MODEL, Body
from ndf_mi.errors import InputError

_SMALL = 1e-2  # rad²: below it the series' relative error, 1e-9, is below that of float32


@dataclass(frozen=True)
class JointTransforms:
    """The transforms of a body's joints in one pose, as flat mi.Float.

    Attributes:
        matrices: J × 3 rows × 4: from rest to world space, with root rotation and translation.
        shape: B coefficients, or None.
        features: 9·(J-1): R(θ_j) - I of all joints but the root, row by row; None without pose_dirs.
    """

    matrices: Any
    shape: Any
    features: Any


class SkinnedVertices:
    """N vertices that follow a body's joints: the body itself, or clothes on it. Weights are stored sparsely.

    Args:
        template: (N, 3) rest vertices, metres.
        weights: (N, J) skinning weights, rows sum to 1.
        shape_dirs: (N, 3, B) or None.
        pose_dirs: (N, 3, 9·(J-1)) or None.
    """

    def __init__(self, template: np.ndarray, weights: np.ndarray, shape_dirs: np.ndarray | None = None,
                 pose_dirs: np.ndarray | None = None) -> None:
        self.count = len(template)
        most = max(1, int((weights != 0).sum(1).max(initial=0)))
        joints = np.argsort(-weights, axis=1, kind="stable")[:, :most]
        values = np.take_along_axis(weights, joints, axis=1)
        self._joints = [mi.UInt32(np.ascontiguousarray(column, dtype=np.uint32)) for column in joints.T]
        self._weights = [_data(column) for column in values.T]
        self._template = _data(template)
        self._shape_dirs = _directions(shape_dirs)
        self._pose_dirs = _directions(pose_dirs)

    def apply(self, transforms: JointTransforms) -> mi.Float:
        """The posed vertices in world space, flat (3·N), metres."""
        rest = self._template
        if self._shape_dirs is not None and transforms.shape is not None:
            rest = rest + _combine(self._shape_dirs, transforms.shape)
        if self._pose_dirs is not None and transforms.features is not None:
            rest = rest + _combine(self._pose_dirs, transforms.features)
        x = dr.unravel(mi.Point3f, rest)
        rows = [mi.Vector4f(0), mi.Vector4f(0), mi.Vector4f(0)]
        for joints, weights in zip(self._joints, self._weights, strict=True):
            for row in range(3):
                rows[row] += weights * dr.gather(mi.Vector4f, transforms.matrices, joints * 3 + row)
        posed = [dr.fma(row.x, x.x, dr.fma(row.y, x.y, dr.fma(row.z, x.z, row.w))) for row in rows]
        return dr.ravel(mi.Point3f(*posed))


def skin(body: Body, pose: Any, root_rotation: Any, translation: Any, shape: Any = None) -> mi.Float:
    """The posed vertices of ``body`` in world space, flat (3·V), metres.

    Args:
        pose: (J, 3) axis-angle relative to the parent, radians; the capture format keeps the root's entry at
            zero.
        root_rotation: (3,) axis-angle of the whole body about the world's origin, radians.
        translation: (3,) metres, added after the rotation.
        shape: (B,) coefficients, or None for the template.

    Each may be an array, an mi.TensorXf or a flat mi.Float; gradients flow to those that have them enabled.

    Raises:
        InputError: the body has no skinning model, or an argument has another size.
    """
    return _prepared(body).vertices.apply(joint_transforms(body, pose, root_rotation, translation, shape))


def joint_transforms(
    body: Body, pose: Any, root_rotation: Any, translation: Any, shape: Any = None
) -> JointTransforms:
    """The transforms of the joints, for `SkinnedVertices.apply`; arguments and errors as for `skin`."""
    prepared = _prepared(body)
    count = body.joint_count
    theta = dr.unravel(mi.Vector3f, _values("pose", pose, 3 * count))
    beta = None if shape is None else _values("shape", shape, body.shape_count)
    joints = prepared.joints
    if beta is not None and prepared.joint_dirs is not None:
        joints = joints + _combine(prepared.joint_dirs, beta)
    at = dr.unravel(mi.Vector3f, joints)
    rotation = rodrigues(theta)

    # Pointer jumping: after round n each joint's transform includes those of its 2ⁿ nearest ancestors.
    above = dr.gather(mi.Vector3f, dr.ravel(at), prepared.parent_or_self)
    offset = at - dr.select(prepared.is_root, 0, above)
    rows = [mi.Vector4f(*rotation[i], offset[i]) for i in range(3)]
    for ancestors, ends in prepared.rounds:
        rows = _chain(rows, ancestors, ends)
    root = rodrigues(dr.unravel(mi.Vector3f, _values("root_rotation", root_rotation, 3)))
    shift = dr.unravel(mi.Vector3f, _values("translation", translation, 3))
    posed = [mi.Vector4f(r.x, r.y, r.z, r.w - (r.x * at.x + r.y * at.y + r.z * at.z)) for r in rows]
    world = [sum((root[i, k] * posed[k] for k in range(3)), mi.Vector4f(0, 0, 0, shift[i])) for i in range(3)]

    features = None
    if body.pose_dirs is not None and count > 1:
        by_joint = [rotation[i, k] - float(i == k) for i in range(3) for k in range(3)]
        features = _interleave(by_joint, count)
        features = dr.gather(mi.Float, features, dr.arange(mi.UInt32, 9 * (count - 1)) + 9)
    flat = _interleave([world[i][k] for i in range(3) for k in range(4)], count)
    return JointTransforms(matrices=flat, shape=beta, features=features)


def rodrigues(axis_angle: mi.Vector3f) -> mi.Matrix3f:
    """Rotation matrices of axis-angle vectors, radians: I + a·K + b·K², a = sin θ/θ, b = (1 - cos θ)/θ².

    Near θ = 0 both are series in θ², and the square root never gets 0: the gradient is exact there too.
    """
    squared = dr.squared_norm(axis_angle)
    small = squared < _SMALL
    angle = dr.sqrt(dr.select(small, 1, squared))
    half = dr.sin(0.5 * angle) / angle
    a = dr.select(small, 1 - squared / 6 + squared * squared / 120, dr.sin(angle) / angle)
    b = dr.select(small, 0.5 - squared / 24 + squared * squared / 720, 2 * half * half)
    x, y, z = axis_angle
    return mi.Matrix3f(
        1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y,
        b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x,
        b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y),
    )  # fmt: skip


@dataclass(frozen=True)
class _Prepared:
    """What does not depend on the pose, on the device."""

    vertices: SkinnedVertices
    joints: Any
    joint_dirs: Any
    parent_or_self: Any
    is_root: Any
    rounds: list[tuple[Any, Any]]


_cache: weakref.WeakKeyDictionary[Body, dict[str, _Prepared]] = weakref.WeakKeyDictionary()


def _prepared(body: Body) -> _Prepared:
    """Prepares ``body``, once for each variant."""
    by_variant = _cache.setdefault(body, {})
    variant = str(mi.variant())
    if variant not in by_variant:
        missing = [name for name in MODEL if getattr(body, name) is None]
        if missing:
            raise InputError("body", f"no {', '.join(missing)}", "a body with a skinning model")
        assert body.template is not None and body.weights is not None
        assert body.parents is not None and body.joints is not None
        parents, own = body.parents, np.arange(len(body.parents))
        rounds = []
        ancestors = parents.copy()
        while (ancestors >= 0).any():
            ends = ancestors < 0
            rounds.append((mi.UInt32(np.where(ends, own, ancestors).astype(np.uint32)), mi.Bool(ends)))
            ancestors = np.where(ends, -1, ancestors[ancestors])
        by_variant[variant] = _Prepared(
            vertices=SkinnedVertices(body.template, body.weights, body.shape_dirs, body.pose_dirs),
            joints=_data(body.joints),
            joint_dirs=_directions(body.joint_dirs),
            parent_or_self=mi.UInt32(np.where(parents < 0, own, parents).astype(np.uint32)),
            is_root=mi.Bool(parents < 0),
            rounds=rounds,
        )
    return by_variant[variant]


def _chain(rows: list[Any], ancestors: Any, ends: Any) -> list[Any]:
    """Each joint's transform followed by its ancestor's; unchanged where the chain ``ends`` at the root."""
    flat = _interleave([rows[i][k] for i in range(3) for k in range(4)], dr.width(ancestors))
    out = []
    for i, own in enumerate(rows):
        u = dr.gather(mi.Vector4f, flat, ancestors * 3 + i)
        row = u.x * rows[0] + u.y * rows[1] + u.z * rows[2] + mi.Vector4f(0, 0, 0, u.w)
        out.append(dr.select(ends, own, row))
    return out


def _interleave(columns: list[Any], count: int) -> mi.Float:
    """A flat array of ``count`` records, each of one value a column."""
    stride = len(columns)
    flat = dr.zeros(mi.Float, stride * count)
    at = dr.arange(mi.UInt32, count) * stride
    for k, column in enumerate(columns):
        dr.scatter(flat, column, at + k)
    return flat


def _combine(directions: Any, coefficients: Any) -> mi.Float:
    """Σ_b directions[…, b] · coefficients[b], directions flat with b fastest."""
    count = dr.width(coefficients)
    chosen = dr.arange(mi.UInt32, dr.width(directions)) % count
    return dr.block_sum(directions * dr.gather(mi.Float, coefficients, chosen), count)


def _data(array: np.ndarray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(array, dtype=np.float32).ravel())


def _directions(array: np.ndarray | None) -> mi.Float | None:
    return None if array is None or array.size == 0 else _data(array)


def _values(name: str, value: Any, count: int) -> mi.Float:
    """``value`` as a flat mi.Float of ``count`` values, opaque so that no kernel bakes it in."""
    flat = value.array if isinstance(value, mi.TensorXf) else value
    if not isinstance(flat, mi.Float):
        if not dr.is_jit_v(flat):
            flat = np.asarray(flat, dtype=np.float32)
        flat = _data(flat) if isinstance(flat, np.ndarray) else dr.ravel(flat)
    if dr.width(flat) != count:
        raise InputError(name, f"{dr.width(flat)} values", f"{count}")
    dr.make_opaque(flat)
    return flat
