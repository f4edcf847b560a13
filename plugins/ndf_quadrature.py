"""The integrator plugin ``ndf_quadrature``."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.deprecated import rename_parameter
from ndf_mi.errors import InputError
from ndf_mi.render import properties
from ndf_mi.render.performers import FieldMedium, NeuralField, emitting
from ndf_mi.render.quadrature import Radiance, quadrature
from ndf_mi.render.sampling import join
from ndf_mi.render.transport import Performer

RAYS_AT_ONCE = 1 << 15
"""Rays of one pass. They bound memory, at about 50 bytes a candidate sample."""

CHANNELS = {
    "depth": ("depth.T",),
    "opacity": ("opacity.A",),
    "uvl": ("uvl.U", "uvl.V", "uvl.L"),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
}
"""What can be output besides radiance, and the names of its channels."""


GEOMETRY = frozenset({"uvl", "normal"})
"""Those of the body's surface, three channels each."""


def register() -> None:
    """Defines and registers the plugin for the active variant."""
    from mitsuba.ad.integrators.common import ADIntegrator

    class NDFQuadrature(ADIntegrator):
        r"""
        .. _integrator-ndf_quadrature:

        Emission and absorption of a neural deformable field (:monosp:`ndf_quadrature`)
        --------------------------------------------------------------------------------

        Renders the scene's ``ndf`` medium by the paper's equation, L = Σ T_i (1 − exp(−σ_i δ_i)) c_i, and the
        scene's environment emitter behind it. By default only the rays' positions in pixels are random.

        .. pluginparameters::

         * - samples
           - |int|
           - Candidate samples a ray, spread evenly over the body's padded box. (Default: 128)
         * - stratified
           - |bool|
           - Shift each ray's samples by a random fraction of their spacing, drawn from the sampler. (Default:
             false)
         * - min_transmittance
           - |float|
           - Early termination: samples whose transmittance is below this are skipped. Their transmittance
             follows from the densities alone, evaluated once more for it, which pays where gradients are
             taken. (Default: 0, none is skipped)
         * - aovs
           - |string|
           - What else to output, separated by commas: depth (distance along the ray), opacity, uvl (the
             expected u, v and l), normal (of the body's surface at the closest point). (Default: none)

        - Differentiable in the medium's parameters and in the sensor's rays, by plain automatic
          differentiation.
        - Evaluates only samples in the band, all of them together.
        - Ignores surfaces, other media and all emitters but the environment: no light is scattered.
        - A scene must hold exactly one ``ndf`` medium.

        .. tabs::
            .. code-tab:: xml

                <integrator type="ndf_quadrature">
                    <integer name="samples" value="128"/>
                    <string name="aovs" value="depth,opacity,uvl,normal"/>
                </integrator>
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.samples = properties.count(props, "ndf_quadrature", "samples", 128)
            self.stratified = bool(props.get("stratified", False))
            rename_parameter(props, "ndf_quadrature", "hidden", "min_transmittance")
            self.min_transmittance = float(props.get("min_transmittance", 0.0))
            if not 0 <= self.min_transmittance < 1:
                found = f"{self.min_transmittance:g}"
                raise InputError("ndf_quadrature: min_transmittance", found, "a number in [0, 1)")
            self.aovs = properties.aovs(props, "ndf_quadrature", CHANNELS)

        def aov_names(self) -> list[str]:
            return [channel for name in self.aovs for channel in CHANNELS[name]]

        def sample(
            self, mode: dr.ADMode, scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f,
            active: mi.Bool = True, **_: Any,
        ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float], Any]:
            performer = _performer(scene)
            offset = sampler.next_1d() if self.stratified else None
            width = dr.width(ray.d)
            passes = [self._pass(performer, ray, offset, first, min(RAYS_AT_ONCE, width - first))
                      for first in range(0, width, RAYS_AT_ONCE)]
            colour = mi.Color3f(*[join([seen.colour[i] for seen in passes]) for i in range(3)])
            opacity = join([seen.opacity for seen in passes])
            environment = scene.environment()
            if environment is not None:
                si = dr.zeros(mi.SurfaceInteraction3f, width)
                si.wi = -ray.d
                colour += (1.0 - opacity) * environment.eval(si)
            return mi.Spectrum(colour), opacity > 0.5, self._aov_values(passes), None

        def _pass(
            self, performer: Performer, ray: mi.Ray3f, offset: mi.Float | None, first: int, count: int
        ) -> Radiance:
            """Radiance along `count` rays from number `first` on."""
            index = dr.arange(mi.UInt32, count) + dr.opaque(mi.UInt32, first)
            part = mi.Ray3f(dr.gather(mi.Point3f, ray.o, index), dr.gather(mi.Vector3f, ray.d, index))
            jitter = None
            if offset is not None:
                samples = self.samples * performer.volume.sample_factor
                jitter = dr.repeat(dr.gather(mi.Float, offset, index), samples)
            geometry = not GEOMETRY.isdisjoint(self.aovs)
            return quadrature(performer.volume, part, self.samples, jitter=jitter, scale=performer.scale,
                              min_transmittance=self.min_transmittance, geometry=geometry)

        def _aov_values(self, passes: list[Radiance]) -> list[mi.Float]:
            values: list[mi.Float] = []
            for name in self.aovs:
                each = [getattr(seen, "u" if name == "uvl" else name) for seen in passes]
                values += [join(part) for part in (zip(*each, strict=True) if name in GEOMETRY else [each])]
            return values

        def to_string(self) -> str:
            return (f"NDFQuadrature[samples = {self.samples}, stratified = {self.stratified}, "
                    f"min_transmittance = {self.min_transmittance}, aovs = {self.aovs}]")

    mi.register_integrator("ndf_quadrature", lambda props: NDFQuadrature(props))


def _performer(scene: mi.Scene) -> Performer:
    """The field of the only ``ndf`` medium among the interiors of the scene's shapes."""
    found: list[NeuralField] = []
    for shape in scene.shapes():
        medium = shape.interior_medium()
        if isinstance(medium, FieldMedium) and not any(medium.neural_field is other for other in found):
            found.append(medium.neural_field)
    if len(found) != 1:
        media = f"{len(found)} `ndf` media in the scene"
        raise InputError("ndf_quadrature", media, "exactly one, as the interior of a shape")
    return emitting(found[0])
