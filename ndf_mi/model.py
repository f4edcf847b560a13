"""N(x, d, θ) = (σ, c): projection, deformation and field composed."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi import variants
from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.coordinates import Coordinates
from ndf_mi.errors import InputError
from ndf_mi.field import Field, FieldParameters, Preset
from ndf_mi.field.occupancy import Occupancy
from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.projection import Bands, PosedSurface, Projection, Surface

NETWORKS = ("auto", "batched", "fused", "half")
"""How evaluated code runs the networks where nothing is differentiated: as matrix products over all samples,
as cooperative vectors, or as cooperative vectors in half precision; `auto` takes the faster of the first two
(:func:`ndf_mi.variants.fused_width`)."""


def networks_here() -> tuple[str, ...]:
    """The entries of `NETWORKS` that the active variant supports."""
    single = "single" in variants.cooperative_precisions()
    return tuple(name for name in NETWORKS if name != "fused" or single)


class Model:
    """A neural deformable field around a body: what depends neither on the pose nor on training.

    Args:
        body: triangles and texture coordinates.
        poses: the first gives the shape that the search tree is built for, and the number of joints.
        preset: the networks' architecture.
        bands: (V, 2) how far the band reaches outside and inside at each vertex, in metres, linear over
            triangles; at most the preset's `band` and `band_inside`. None for these everywhere.

    Attributes:
        surface: the body's triangles, texture coordinates and search tree.
        bands: the widths for each place, or None.
        coordinates: what the networks take for a place.
        field: the networks' architecture.

    Raises:
        InputError: `bands` has another shape, or a width is not above 0 or larger than the preset's.
    """

    def __init__(self, body: Body, poses: Poses, preset: Preset, bands: np.ndarray | None = None) -> None:
        self.surface = Surface(body.faces, body.uv, body.uv_faces, poses.vertices[0])
        self.bands = None if bands is None else Bands(self.surface, bands)
        if self.bands is not None:
            for name, largest in (("band", self.bands.outside), ("band_inside", self.bands.inside)):
                # Widths are in single precision.
                if largest > getattr(preset, name) * (1 + 1e-5):
                    raise InputError("bands", f"a width of {largest:g} m",
                                     f"at most {getattr(preset, name):g} m, the preset's `{name}`")
        self.coordinates = Coordinates(preset, body, poses)
        self.field = Field(preset, poses.pose.shape[1])

    @property
    def band(self) -> float:
        """The band's half width δ_N in metres; the largest where it varies."""
        return self.field.preset.band

    def pose(self, vertices: mi.Float) -> PosedSurface:
        """The surface and its band in one pose; `vertices` are flat (3·V), world, in metres."""
        return PosedSurface(self.surface, vertices, self.band if self.bands is None else self.bands)


class PosedModel:
    """A :class:`Model` with parameters at one pose: a `VolumeField`, also for media.

    Args:
        parameters: of the networks; gradients flow to them.
        pose: flat (3·J) axis-angles.
        occupancy: leaves out what is empty while training.
        networks: one of `NETWORKS`.

    Raises:
        InputError: the active variant has no such way to run networks.
    """

    def __init__(
        self, model: Model, parameters: FieldParameters, surface: PosedSurface, pose: mi.Float,
        occupancy: Occupancy | None = None, networks: str = "auto",
    ) -> None:
        known = networks_here()
        if networks not in known:
            raise InputError("networks", repr(networks), "one of " + ", ".join(known))
        preset = model.field.preset
        self.surface = surface
        self.bound = model.field.bind(pose, parameters)
        self.bbox = surface.bbox
        self.majorant = model.field.majorant
        self.sample_factor = preset.sample_factor
        self._coordinates = model.coordinates
        self._band = preset.band
        self._inside = preset.band_inside
        self._fade = preset.band_fade
        self._varies = model.bands is not None
        self._occupancy = occupancy
        self._networks = networks

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """False only where x is certainly outside the band; reads one cell of a grid."""
        return self.surface.may_contain(x)

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """Projects points, detached. Valid: active, in the band, and kept by the occupancy if any."""
        with dr.suspend_grad():
            found = self.surface.project(x, active)
            located = self._located(found)
            if not self._coordinates.barycentric:
                located.barycentric = dr.zeros(mi.Point3f)
            if self._occupancy is not None:
                kept, located.weight = self._occupancy.keep(self.unit(found.uv, found.l))
                located.valid &= kept
            return located

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """σ at located points in 1/m, zero in inactive lanes; detached, for evaluated code."""
        with dr.suspend_grad():
            active = active & located.valid
            sigma = self.bound.density(self._coordinates(x, located, active), active)
            return dr.select(active, sigma * self._fading(located.l, located.band), 0.0)

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """Density and colour at located points, for evaluated code.

        Attached to the parameters. Where gradients are tracked in the points or in the body's vertices, also
        attached to these: the points are then projected onto the triangles found, in closed form and without
        another search.
        """
        active = active & located.valid
        if dr.grad_enabled(x) or dr.grad_enabled(self.surface.vertices):
            located = self._located(self.surface.project_onto(located.triangle, x, active))
        u, d, n = self._inputs(x, d, located, active)
        fused = self._networks != "batched"
        if self._networks == "auto":
            fused = self.bound.width <= variants.fused_width()
        if not fused or dr.grad_enabled(u, d) or self.bound.attached:
            sigma, colour = self.bound.batched(u, d, n)
        else:
            if not self.bound.packed:
                # Attached all the same: the packed weights may serve later calls that need gradients.
                with dr.resume_grad():
                    self.bound.pack(half=self._networks == "half")
            sigma, colour = self.bound.fused(u, d, n, active)
            # Each of the arrays would otherwise be a kernel of its own with the whole network in it.
            dr.eval(sigma, colour)
        return self._sample(sigma, colour, located, active)

    def fused(self, x: mi.Point3f, d: mi.Vector3f, active: mi.Bool | bool = True) -> FieldSample:
        """Density and colour at any point, for symbolic code; zero density outside the band."""
        located = self._located(self.surface.project(x, mi.Bool(active)))
        u, d, n = self._inputs(x, d, located, located.valid)
        return self._sample(*self.bound.fused(u, d, n, located.valid), located, located.valid)

    def unit(self, uv: mi.Point2f, l: mi.Float) -> mi.Point3f:
        """(u*, v*, l*) in the unit cube, whatever the networks' coordinates: l from −`band_inside` to `band`
        becomes 0 to 1."""
        scale = 1.0 / (self._band + self._inside)
        return mi.Point3f(uv.x, uv.y, dr.fma(l, scale, self._inside * scale))

    def _located(self, found: Projection) -> Located:
        """A projection, attached; valid in the band."""
        valid = found.valid if self._varies else found.valid & (found.l >= -self._inside)
        weight = mi.Float(1.0)
        return Located(found.triangle, found.uv, found.l, found.normal, found.barycentric, valid, weight,
                       found.band)

    def _inputs(
        self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool
    ) -> tuple[list[mi.Float], mi.Vector3f, mi.Normal3f]:
        """The networks' inputs, constant in inactive lanes: a NaN there would poison every gradient."""
        u = self._coordinates(x, located, active)
        return (u, dr.select(active, d, mi.Vector3f(0.0, 0.0, 1.0)),
                dr.select(active, located.normal, mi.Normal3f(0.0, 0.0, 1.0)))

    def _sample(self, sigma: mi.Float, colour: mi.Color3f, located: Located, active: mi.Bool) -> FieldSample:
        l = dr.select(active, located.l, 0.0)
        uv = dr.select(active, located.uv, 0.0)
        # Also a divisor.
        band = dr.select(active, located.band, 1.0) if self._varies else located.band
        sigma = dr.select(active, sigma * self._fading(l, band), 0.0)
        return FieldSample(sigma, colour, mi.Point3f(uv.x, uv.y, l), located.normal, dr.detach(band.x))

    def _fading(self, l: mi.Float, band: mi.Point2f) -> mi.Float:
        """Factor on the density that falls smoothly from 1 to 0 towards the band's edges; `band` are its
        widths where they vary."""
        factor = mi.Float(1.0)
        if self._fade > 0:
            outside, inside = band if self._varies else (self._band, self._inside)
            for depth in ((outside - l) / outside, (inside + l) / inside):
                s = dr.clip(depth / self._fade, 0.0, 1.0)
                factor *= s * s * dr.fma(s, -2.0, 3.0)
        return factor
