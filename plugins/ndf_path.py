"""The integrator plugin ``ndf_path``."""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.errors import InputError
from ndf_mi.render import properties
from ndf_mi.render.performers import FieldMedium, performers
from ndf_mi.render.surfaces import Origin, next_surface, sample_vertex
from ndf_mi.render.transport import Crossing, Performer, Transport

PATHS_AT_ONCE = 1 << 18
"""Paths of one pass, if the film has no more pixels. They bound memory."""

CHANNELS = {"depth": "depth.T", "opacity": "opacity.A"}
"""What can be output besides radiance, and the names of its channels."""


def register() -> None:
    """Defines and registers the plugin for the active variant."""
    from mitsuba.ad.integrators.common import ADIntegrator

    class NDFPath(ADIntegrator):
        r"""
        .. _integrator-ndf_path:

        Path tracing around performers (:monosp:`ndf_path`)
        ----------------------------------------------------

        Neural deformable fields emit and absorb light by the paper's equation, as under ``ndf_quadrature``;
        surfaces and emitters of any kind are path traced. Performers are seen in mirrors and through glass,
        stand in front of and behind other things, cast shadows and light their surroundings.

        .. pluginparameters::

         * - max_depth
           - |int|
           - Longest path in segments: 1 shows emitters and performers themselves, 2 adds light scattered once
             by surfaces; -1 is no limit. (Default: 6)
         * - rr_depth
           - |int|
           - Segments after which Russian roulette begins. (Default: 5)
         * - samples
           - |int|
           - Candidate samples a performer and segment, spread evenly over the segment's part in the body's
             padded box. (Default: 128)
         * - stratified
           - |bool|
           - Shift each segment's samples by a random fraction of their spacing, drawn from the sampler.
             (Default: false)
         * - hide_emitters
           - |bool|
           - Hide emitters that are seen directly. (Default: false)
         * - aovs
           - |string|
           - What else to output, separated by commas: depth (distance along the ray to the performers),
             opacity (of the performers before the first surface). (Default: none)

        - Supports any number of performers: ``ndf`` media in shapes whose BSDF lets light through. Where
          performers overlap, they absorb and emit together.
        - Without performers it equals Mitsuba's ``path``; with one and only an environment,
          ``ndf_quadrature``.
        - Performers do not scatter light: light that falls on them is not seen on them, but is missing
          behind them.
        - Performers are not sampled as emitters: their light reaches surfaces by BSDF sampling.
        - Shapes with BSDF ``null`` are passed through: they neither end a segment nor block shadow rays.
        - Refuses other media.
        - Differentiable in the parameters of ``ndf`` media, by plain automatic differentiation. Refuses
          gradients of other parameters.

        .. tabs::
            .. code-tab:: xml

                <integrator type="ndf_path">
                    <integer name="max_depth" value="6"/>
                    <integer name="samples" value="128"/>
                </integrator>
        """

        def __init__(self, props: mi.Properties) -> None:
            depth = int(props.get("max_depth", 6))
            if depth != -1 and depth < 1:
                expected = "a whole number above 0, or -1 for no limit"
                raise InputError("ndf_path: max_depth", str(depth), expected)
            # Mitsuba reads both itself, and accepts any number.
            properties.count(props, "ndf_path", "rr_depth", 5)
            super().__init__(props)
            self.stratified = bool(props.get("stratified", False))
            self.aovs = properties.aovs(props, "ndf_path", CHANNELS)
            self.transport = Transport(properties.count(props, "ndf_path", "samples", 128))

        def aov_names(self) -> list[str]:
            return [CHANNELS[name] for name in self.aovs]

        def sample(
            self, mode: dr.ADMode, scene: mi.Scene, sampler: mi.Sampler, ray: mi.Ray3f,
            active: mi.Bool = True, **_: Any,
        ) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float], Any]:
            fields = performers(scene, "ndf_path")
            if mode != dr.ADMode.Primal:
                _check_gradients(scene, ray)
            width = dr.width(ray.d)
            ray = _wide(ray, width)
            active = mi.Bool(active) & dr.full(mi.Bool, True, width)
            L = mi.Color3f(dr.zeros(mi.Float, width))
            β = mi.Color3f(dr.full(mi.Float, 1.0, width))
            η = dr.full(mi.Float, 1.0, width)
            origin = Origin.camera(width)
            scattered = dr.full(mi.Bool, False, width)
            opacity, aovs = dr.zeros(mi.Float, width), [dr.zeros(mi.Float, width) for _ in self.aovs]
            # Literals would give the first segment kernels of its own.
            dr.make_opaque(active, L, β, η, origin, scattered)

            for depth in itertools.count():
                # Through the performers, up to the next surface or out of the scene.
                skip = self.hide_emitters and depth == 0
                found = next_surface(scene, ray, active, skip_emitters=skip)
                segment = mi.Ray3f(ray)
                segment.maxt = dr.select(found.is_valid(), found.t, ray.maxt)
                crossing = self._cross(fields, segment, active, sampler, found)
                if crossing is not None:
                    L += β * crossing.colour
                    β *= crossing.transmittance
                    if depth == 0:
                        opacity = 1.0 - crossing.transmittance
                        depths = crossing.depth * dr.rcp(dr.maximum(opacity, 1e-6))
                        aovs = [depths if name == "depth" else opacity for name in self.aovs]

                # The surface: emission, scattered light of a sampled emitter, and the direction onward.
                last = depth + 1 == self.max_depth
                with dr.suspend_grad():
                    environment = scattered | (not self.hide_emitters)
                    vertex = sample_vertex(scene, sampler, ray, found, origin, active, environment, last)
                    sampler.schedule_state()
                    dr.eval(vertex)
                L += β * vertex.emitted
                scattered |= vertex.scattered
                if last:
                    break
                crossing = self._cross(fields, vertex.shadow, dr.any(vertex.lit != 0.0), sampler)
                L += β * (vertex.lit if crossing is None else vertex.lit * crossing.transmittance)
                β *= vertex.weight
                η *= vertex.eta
                survival, active = self._roulette(dr.detach(β), η, sampler, vertex.active, depth + 1)
                β *= survival
                ray, origin = vertex.onward, vertex.origin
                sampler.schedule_state()
                dr.eval(L, β, η, scattered, active)
                if not dr.any(active):
                    break
            behind = not self.hide_emitters and scene.environment() is not None
            return mi.Spectrum(L), scattered | (dr.detach(opacity) > 0.5) | behind, aovs, None

        def _cross(
            self, fields: list[Performer], ray: mi.Ray3f, active: mi.Bool, sampler: mi.Sampler, *others: Any
        ) -> Crossing | None:
            """Integrates the performers along segments; None without performers. Evaluates all arguments."""
            jitter = sampler.next_1d() if self.stratified else None
            if not fields:
                return None
            sampler.schedule_state()
            dr.eval(ray, active, jitter, *others)
            return self.transport(fields, ray, active, jitter)

        def _roulette(
            self, β: mi.Color3f, η: mi.Float, sampler: mi.Sampler, active: mi.Bool, depth: int
        ) -> tuple[mi.Float, mi.Bool]:
            """Ends paths at random by their throughput from `rr_depth` on; the factor on those that go on,
            and which do."""
            largest = dr.max(β)
            probability = dr.minimum(largest * dr.square(η), 0.95)
            play = dr.opaque(mi.UInt32, depth) >= self.rr_depth
            lives = ~play | (sampler.next_1d() < probability)
            factor = dr.select(play, dr.rcp(dr.maximum(probability, 1e-20)), 1.0)
            return factor, active & lives & (largest != 0.0)

        def render(
            self, scene: mi.Scene, sensor: int | mi.Sensor = 0, seed: int = 0, spp: int = 0,
            develop: bool = True, evaluate: bool = True,
        ) -> mi.TensorXf:
            """Renders in passes of some of the samples a pixel each."""
            if isinstance(sensor, int):
                sensor = scene.sensors()[sensor]
            film = sensor.film()
            size = film.crop_size() + (2 * film.rfilter().border_size() if film.sample_border() else 0)
            pixels = int(dr.prod(size))
            sampler = sensor.sampler().clone()
            if spp:
                sampler.set_sample_count(spp)
            spp = sampler.sample_count()
            # The largest divisor within the limit, or 1.
            divisors = (each for each in range(1, spp + 1) if spp % each == 0)
            each = max((each for each in divisors if each * pixels <= PATHS_AT_ONCE), default=1)
            if each == spp:
                return super().render(scene, sensor, seed, spp, develop, evaluate)
            with dr.suspend_grad():
                sampler.set_samples_per_wavefront(each)
                sampler.seed(seed, pixels * each)
                film.prepare(self.aov_names())
                for _ in range(spp // each):
                    ray, weight, position = self.sample_rays(scene, sensor, _Part(sampler, each))
                    L, valid, aovs, _ = self.sample(dr.ADMode.Primal, scene, sampler, ray)
                    block = film.create_block()
                    block.set_coalesce(block.coalesce() and each >= 4)
                    ADIntegrator._splat_to_block(block, film, position, value=L * weight, weight=1.0,
                                                 alpha=dr.select(valid, mi.Float(1), mi.Float(0)), aovs=aovs,
                                                 wavelengths=ray.wavelengths)
                    film.put_block(block)
                    sampler.advance()
                    sampler.schedule_state()
                    dr.eval(block.tensor())
                return film.develop()

        def to_string(self) -> str:
            return (f"NDFPath[max_depth = {self.max_depth}, rr_depth = {self.rr_depth}, samples = "
                    f"{self.transport.samples}, stratified = {self.stratified}, hide_emitters = "
                    f"{self.hide_emitters}, aovs = {self.aovs}]")

    mi.register_integrator("ndf_path", lambda props: NDFPath(props))


class _Part:
    """A sampler that claims `count` samples a pixel, to draw the pixel positions of one pass."""

    def __init__(self, sampler: mi.Sampler, count: int) -> None:
        self.sample_count = lambda: count
        self.next_1d, self.next_2d = sampler.next_1d, sampler.next_2d


def _wide(ray: mi.Ray3f, width: int) -> mi.Ray3f:
    """One ray a lane, detached; values shared by all lanes would become literals in kernels."""
    wide = dr.zeros(mi.Ray3f, width)
    wide.o += dr.detach(ray.o)
    wide.d += dr.detach(ray.d)
    wide.maxt = dr.minimum(dr.detach(ray.maxt), dr.full(mi.Float, dr.inf, width))
    wide.time += dr.detach(ray.time)
    wide.wavelengths = ray.wavelengths
    dr.make_opaque(wide)
    return wide


def _check_gradients(scene: mi.Scene, ray: mi.Ray3f) -> None:
    """Refuses gradients that are not implemented, instead of returning zero."""
    expected = "gradients of an `ndf` medium's parameters only"
    if dr.grad_enabled(ray):
        raise InputError("ndf_path", "gradients of the sensor's rays", expected)
    params = mi.traverse(scene)
    for key, value in params.items():
        if dr.grad_enabled(value) and not isinstance(params.properties[key][2], FieldMedium):
            raise InputError(f"ndf_path: {key}", "gradients of this parameter", expected)
