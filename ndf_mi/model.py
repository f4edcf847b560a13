"""N(x, d, θ) = (c, σ): projection, deformation and field composed; what plugins, learning and comparison hold."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ndf_mi import variants
from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.coordinates import coordinates
from ndf_mi.errors import InputError
from ndf_mi.field import Field, Preset
from ndf_mi.field.occupancy import Occupancy
from ndf_mi.field.sample import FieldSample
from ndf_mi.projection import PosedSurface, Surface

NETWORKS = ("auto", "batched", "fused", "half")
"""How evaluated code runs the networks where nothing is differentiated: as matrix products over all samples, as cooperative vectors, as
these in half precision; `auto` takes the quicker of the first two (:func:`ndf_mi.variants.fused_width`)."""

_LONE = 1 << 31
"""Bit of a handle: the sample is one of the few that are evaluated in an empty cell. Triangles are fewer than this."""


def networks_here() -> tuple[str, ...]:
    """Those of `NETWORKS` that the active variant has."""
    return tuple(name for name in NETWORKS if name != "fused" or "single" in variants.cooperative_precisions())


class Model:
    """A neural deformable field around a body, before a pose is given.

    Args:
        body: triangles and texels.
        poses: the first gives the shape that the search tree is built for, and the number of joints.
        preset: the networks' architecture.
        seed: of the networks' initial weights.

    Attributes:
        surface: the body's triangles, texels and search tree.
        coordinates: what the networks take for a place.
        field: the networks.
    """

    def __init__(self, body: Body, poses: Poses, preset: Preset, seed: int = 0) -> None:
        self.surface = Surface(body.faces, body.uv, body.uv_faces, poses.vertices[0])
        self.coordinates = coordinates(preset, body, poses)
        self.field = Field(preset, poses.pose.shape[1], seed)

    @property
    def band(self) -> float:
        """The band's half width δ_N in metres."""
        return self.field.preset.band


class PosedModel:
    """A :class:`Model` at one pose: a `VolumeField` for the quadrature, and the medium's coefficients.

    Args:
        model: coordinates and networks.
        surface: the posed body, reusable as long as the pose stays.
        pose: flat (3·J) axis-angles.
        occupancy: in training, leaves out what is empty; its `observe` is the caller's to call.
        networks: one of `NETWORKS`.

    Raises:
        InputError: there is no such way to run networks.
    """

    def __init__(
        self, model: Model, surface: PosedSurface, pose: mi.Float, occupancy: Occupancy | None = None, networks: str = "auto"
    ) -> None:
        known = networks_here()
        if networks not in known:
            raise InputError("networks", repr(networks), "one of " + ", ".join(known))
        preset = model.field.preset
        self.surface = surface
        self.bound = model.field.bind(pose)
        self.bbox = surface.bbox
        self.majorant = model.field.majorant
        self.strata = preset.strata
        self._coordinates = model.coordinates
        self._band = preset.band
        self._inside = preset.band_inside
        self._fade = preset.band_fade
        self._occupancy = occupancy
        self._networks = networks

    def near(self, x: mi.Point3f) -> mi.Bool:
        """False only where x is outside the band for certain; cheap."""
        return self.surface.near(x)

    def locate(self, x: mi.Point3f, active: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        """The closest triangle of each point, detached, and whether the point is in the band; with an occupancy, also whether it is to
        be evaluated, and in the handle's highest bit whether it stands for others of an empty cell."""
        triangle = self.surface.closest(x, active)
        found = self.surface.project_onto(triangle, x, active)
        keep = found.valid & (found.l >= -self._inside)
        if self._occupancy is None:
            return triangle, keep
        kept, lone = self._occupancy.keep(self.unit(found.uv, found.l))
        return triangle | dr.select(lone, mi.UInt32(_LONE), 0), keep & kept

    def density(self, x: mi.Point3f, handle: mi.UInt32, active: mi.Bool) -> mi.Float:
        """The density at located points, times the number of samples that each stands for; detached, for evaluated code."""
        with dr.suspend_grad():
            found = self.surface.project_onto(self._triangle(handle), x, active)
            active = active & found.valid & (found.l >= -self._inside)
            sigma = self.bound.density(self._coordinates(x, found, active), active)
            return dr.select(active, sigma * self._fading(found.l) * self._weight(handle), 0.0)

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, handle: mi.UInt32, active: mi.Bool) -> FieldSample:
        """Density, colour and coordinates at located points, for evaluated code; attached to x, vertices and weights."""
        sample = self._evaluate(x, d, self._triangle(handle), active)
        if self._occupancy is not None:
            sample.weight = self._weight(handle)
        return sample

    def fused(self, x: mi.Point3f, d: mi.Vector3f, active: mi.Bool | bool = True) -> FieldSample:
        """Density, colour and coordinates at any point, for symbolic code. Density is zero outside the band."""
        active = mi.Bool(active) & self.surface.near(x)
        triangle = self.surface.closest(x, active)
        return self._evaluate(x, d, triangle, active, symbolic=True)

    def unit(self, uv: mi.Point2f, l: mi.Float) -> mi.Point3f:
        """(u*, v*, l*) in the unit cube, whatever the networks' coordinates: l from −`band_inside` to `band` becomes 0 to 1."""
        scale = 1.0 / (self._band + self._inside)
        return mi.Point3f(uv.x, uv.y, dr.fma(l, scale, self._inside * scale))

    def _evaluate(self, x: mi.Point3f, d: mi.Vector3f, triangle: mi.UInt32, active: mi.Bool, symbolic: bool = False) -> FieldSample:
        found = self.surface.project_onto(triangle, x, active)
        active = active & found.valid & (found.l >= -self._inside)
        # A non-finite input in a masked lane would poison every weight's gradient.
        l = dr.select(active, found.l, 0.0)
        uv = dr.select(active, found.uv, 0.0)
        u = self._coordinates(x, found, active)
        d = dr.select(active, d, mi.Vector3f(0.0, 0.0, 1.0))
        n = dr.select(active, found.normal, mi.Normal3f(0.0, 0.0, 1.0))
        fused = symbolic or (self._prefers_fused() and not dr.grad_enabled(list(u), d) and not self.bound.attached)
        if fused and not symbolic and not self.bound.packed:
            # Attached all the same: it may serve for more than the call under way.
            with dr.resume_grad():
                self.bound.pack(half=self._networks == "half")
        sigma, colour = self.bound.fused(u, d, n, active) if fused else self.bound.batched(u, d, n)
        if fused and not symbolic:
            # Each of the arrays would otherwise be a kernel of its own with the whole network in it.
            dr.eval(sigma, colour, l, uv, found.normal)
        sigma = dr.select(active, sigma * self._fading(l), 0.0)
        return FieldSample(sigma, colour, mi.Point3f(uv.x, uv.y, l), found.normal)

    def _prefers_fused(self) -> bool:
        """Whether cooperative vectors are wanted where either form would do: small networks are quicker so, forward."""
        return self.bound.width <= variants.fused_width() if self._networks == "auto" else self._networks != "batched"

    def _triangle(self, handle: mi.UInt32) -> mi.UInt32:
        return handle if self._occupancy is None else handle & (_LONE - 1)

    def _weight(self, handle: mi.UInt32) -> mi.Float:
        """How many samples each stands for."""
        if self._occupancy is None:
            return mi.Float(1.0)
        return dr.select((handle & _LONE) != 0, mi.Float(1.0 / self._occupancy.explore), 1.0)

    def _fading(self, l: mi.Float) -> mi.Float:
        """Factor on the density, smoothly from 1 to 0 towards the band's edges."""
        factor = mi.Float(1.0)
        if self._fade > 0:
            for depth in ((self._band - l) / self._band, (self._inside + l) / self._inside):
                s = dr.clip(depth / self._fade, 0.0, 1.0)
                factor *= s * s * dr.fma(s, -2.0, 3.0)
        return factor
