"""Animatable NeRF around a posed body: a field for quadrature.

A point near the posed body takes the blend weights of the closest point of its surface, which a network
corrects; inverse skinning with them gives the point's place around the body at rest, where density and colour
are looked up. There the same network, with a code of its own, gives blend weights again. Both should agree:

    L = mean smooth-L1(w(x) − w_c(x_c))
"""

from __future__ import annotations

from dataclasses import dataclass
from dataclasses import field as member

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi import variants
from ndf_mi.body.skinning import joint_transforms, rodrigues
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field.field import BoundField
from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.methods.animatable_nerf.architecture import Architecture
from ndf_mi.methods.animatable_nerf.networks import BoundBlend
from ndf_mi.methods.animatable_nerf.skinning import Blended, BodyWeights, every, neural_weights, smooth_l1
from ndf_mi.projection import PosedSurface, Surface
from ndf_mi.render.quadrature import Radiance
from ndf_mi.surface.rest_frames import RestFrames

CANONICAL_REACH = 0.1
"""Metres around the body at rest within which its field may be non-zero: twice as far as in world space, as
skinning stretches the space around bent joints."""


@dataclass
class BlendedSample(FieldSample):
    """A field at K points, with what training asks of the blend weights at some of them.

    Attributes:
        disagreement: smooth-L1 distance of the blend weights found in world space and in canonical space,
            mean over the joints, at every `agree_every`-th point; attached.
        counts: whether such a point is dense enough for them to matter.
    """

    disagreement: mi.Float = member(default_factory=lambda: mi.Float(0))
    counts: mi.Bool = member(default_factory=lambda: mi.Bool(False))


class Performer:
    """The body of a capture, at rest and posed, with its blend weights; without the networks. Blend shapes of
    the pose are not undone, as in the release.

    Args:
        capture: with a skinned body. That of a reference surface may take its place.
        reach: metres around the posed body that points are found in.

    Attributes:
        joints: J.
        low, extent: a corner and the edge's length of a cube around all canonical points, metres.

    Raises:
        InputError: the body has no skinning model.
    """

    def __init__(self, capture: Capture, reach: float) -> None:
        body = capture.body
        if not body.skinned:
            raise InputError(f"{capture.path / 'body.npz'}", "a body without joints and blend weights",
                             "a body with a skinning model, by which Animatable NeRF unposes points",
                             "Leave animatable-nerf out of the methods, or add template, joints, "
                             "joint_names, parents and weights to the file.")
        assert body.weights is not None
        self._body, self._poses, self._reach = body, capture.poses, reach
        rest = RestFrames(capture).vertices.astype(np.float32)
        self._surface = Surface(body.faces, body.uv, body.uv_faces, rest)
        self.weights = BodyWeights(body.weights, self._surface)
        self.joints = self.weights.joints
        self.rest = PosedSurface(self._surface, mi.Float(rest.ravel()), CANONICAL_REACH)
        low, high = rest.min(0) - CANONICAL_REACH, rest.max(0) + CANONICAL_REACH
        # Opaque, or each surface would mean other kernels.
        self.low = mi.Point3f(*[dr.opaque(mi.Float, float(v)) for v in low])
        self.extent = dr.opaque(mi.Float, float((high - low).max()))

    def pose(self, frame: int) -> Pose:
        """The body at a frame. Raises InputError if there is no such frame."""
        p = self._poses
        row = p.index(frame)
        surface = PosedSurface(self._surface, mi.Float(p.vertices[row].ravel()), self._reach)
        moved = joint_transforms(self._body, p.pose[row], p.root_rotation[row], p.translation[row], p.shape)
        axis, shift = mi.Vector3f(*p.root_rotation[row].tolist()), mi.Vector3f(*p.translation[row].tolist())
        dr.make_opaque(axis, shift)
        unturn = rodrigues(-axis)
        dr.eval(moved.matrices, unturn)
        return Pose(surface, moved.matrices, unturn, shift)


@dataclass(frozen=True)
class Pose:
    """The body of a :class:`Performer` at a frame.

    Attributes:
        surface: finds the closest points of the body.
        transforms: flat (J·12), from rest to world space.
        unturn, shift: the inverse turn and the shift of the whole body.
    """

    surface: PosedSurface
    transforms: mi.Float
    unturn: mi.Matrix3f
    shift: mi.Vector3f

    def local(self, x: mi.Point3f) -> mi.Point3f:
        """World points in the body's own space, without the turn and the shift of the whole: what the
        networks see."""
        return mi.Point3f(self.unturn @ (mi.Vector3f(x) - self.shift))


@dataclass(frozen=True)
class Canonical:
    """The canonical space with its networks.

    Attributes:
        shape: the architecture.
        body: the body at rest.
        field: density and colour.
        blend: the correction of blend weights there.
    """

    shape: Architecture
    body: Performer
    field: BoundField
    blend: BoundBlend

    def weights(self, x: mi.Point3f, active: mi.Bool) -> tuple[mi.TensorXf, mi.Bool]:
        """Blend weights at canonical points, attached, and which of them are within :data:`CANONICAL_REACH`
        of the body at rest."""
        found = self.body.rest.project(x, active)
        body = self.body.weights.at(found.triangle, found.barycentric, found.valid)
        return neural_weights(body, self.blend(dr.select(found.valid, x, 0.0))), found.valid

    def contains(self, x: mi.Point3f, active: mi.Bool) -> mi.Bool:
        """Which canonical points are within :data:`CANONICAL_REACH` of the body at rest; detached."""
        return self.body.rest.closest(x, active)[1]

    def density(self, x: mi.Point3f, inside: mi.Bool) -> mi.Float:
        """σ in 1/m at canonical points, 0 in the other lanes; detached, for evaluated code."""
        with dr.suspend_grad():
            x = dr.detach(x)
            return dr.select(inside, self.field.density(self.coordinates(x, inside), inside), 0.0)

    def dense(self, x: mi.Point3f, inside: mi.Bool) -> mi.Bool:
        """Which canonical points are dense enough for their blend weights to matter."""
        return self.density(x, inside) > self.shape.agree_above

    def coordinates(self, x: mi.Point3f, inside: mi.Bool) -> list[mi.Float]:
        """What `field` takes for a place: the unit cube for a hash table, metres for γ."""
        x = dr.select(inside, x, 0.0)
        if self.field.preset.encoding == "frequency":
            return list(x)
        return list((x - self.body.low) / self.body.extent)

    def at(self, x: mi.Point3f, d: mi.Vector3f, inside: mi.Bool) -> tuple[mi.Float, mi.Color3f]:
        """σ and linear colour at canonical points; any finite values in the other lanes."""
        u = self.coordinates(x, inside)
        d = dr.select(inside, d, mi.Vector3f(0.0, 0.0, 1.0))
        # The field does not use normals.
        normal = dr.zeros(mi.Normal3f, dr.width(inside))
        field = self.field
        if field.attached or dr.grad_enabled(u) or field.width > variants.fused_width():
            return field.batched(u, d, normal)
        if not field.packed:
            field.pack()
        sigma, colour = field.fused(u, d, normal, inside)
        dr.eval(sigma, colour)
        return sigma, colour


class PosedNerf:
    """Animatable NeRF at one frame: a `VolumeField`.

    Args:
        canonical: density, colour and blend weights at rest.
        pose: the body's.
        blend: the correction of blend weights at this frame.
        agree: whether `evaluate` also finds canonical blend weights, which only training needs.

    Attributes:
        canonical, pose, blend: as given.
    """

    sample_factor = 1

    def __init__(self, canonical: Canonical, pose: Pose, blend: BoundBlend, agree: bool) -> None:
        self._agree = agree
        self.canonical, self.pose, self.blend = canonical, pose, blend
        self.bbox = pose.surface.bbox
        self.majorant = canonical.field.majorant

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """False only where x is certainly out of reach of the body; reads one cell of a grid."""
        return self.pose.surface.may_contain(x)

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """The closest points of the body, detached. Valid: active and within reach."""
        with dr.suspend_grad():
            found = self.pose.surface.project(x, active)
            valid = found.valid & (found.l >= -self.canonical.shape.reach_inside)
            return Located(found.triangle, found.uv, found.l, found.normal, found.barycentric, valid,
                           mi.Float(1.0))

    def weights(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.TensorXf:
        """Blend weights at located points, attached to the networks."""
        body = self.canonical.body.weights.at(located.triangle, located.barycentric, active)
        return neural_weights(body, self.blend(dr.select(active, self.pose.local(x), 0.0)))

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """σ at located points in 1/m, zero in inactive lanes; detached, for evaluated code."""
        with dr.suspend_grad():
            place, inside = self.unposed(x, self.weights(x, located, active), active & located.valid)
            # Each of the arrays would otherwise be a kernel of its own with the network in it.
            dr.eval(place, inside)
            return self.canonical.density(place, self.canonical.contains(place, inside))

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> BlendedSample:
        """Density and colour at located points, attached to the networks; for evaluated code."""
        active = active & located.valid
        weights = self.weights(x, located, active)
        place, inside = self.unposed(x, weights, active)
        if not dr.grad_enabled(place):
            dr.eval(place, inside)
        inside = self.canonical.contains(place, inside)
        sigma, colour = self.canonical.at(place, d, inside)
        sigma = dr.select(inside, sigma, 0.0)
        sample = BlendedSample(sigma, colour, mi.Point3f(located.uv.x, located.uv.y, located.l),
                               located.normal)
        if self._agree:
            step = self.canonical.shape.agree_every
            lane = dr.arange(mi.UInt32, dr.width(inside) // step) * step
            dense = dr.gather(mi.Bool, inside & (dr.detach(sigma) > self.canonical.shape.agree_above), lane)
            place = dr.gather(mi.Point3f, place, lane, mode=dr.ReduceMode.NoConflicts)
            canonical, sample.counts = self.canonical.weights(place, dense)
            sample.disagreement = smooth_l1(every(weights, step), canonical)
        return sample

    def penalty(self, radiance: Radiance) -> mi.Float | None:
        """The mean disagreement of the samples that count."""
        assert isinstance(radiance.samples, BlendedSample)
        return mean_disagreement(radiance.samples.disagreement, radiance.samples.counts)

    def unposed(self, x: mi.Point3f, weights: mi.TensorXf, active: mi.Bool
                 ) -> tuple[mi.Point3f, mi.Bool]:
        """Canonical places, attached to the weights, and which lanes have one; 0 in the others."""
        place, exists = Blended(self.pose.transforms, weights).inverse(x)
        exists &= active
        return dr.select(exists, place, 0.0), exists


def mean_disagreement(values: mi.Float, counts: mi.Bool) -> mi.Float:
    """The mean over the lanes that count, one number; 0 if there is none."""
    count = dr.maximum(dr.sum(dr.select(counts, mi.Float(1.0), 0.0)), 1.0)
    return dr.sum(dr.select(counts, values, 0.0)) / count
