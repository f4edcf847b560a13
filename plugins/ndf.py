"""The medium plugin ``ndf``."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.deprecated import rename_parameter
from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters
from ndf_mi.model import PosedModel
from ndf_mi.render import properties
from ndf_mi.render.nested import Majorants
from ndf_mi.render.sparse_grid import SparseGrid

_PARAMETERS = ("weights", "grid", "vertices", "pose")
"""The parameters that the medium exposes, in this order."""

_MOVED = (
    "the body has moved, and {share:.2g} % of its band lie outside the shells and are not seen. Shells do "
    "not move: load the scene again at this pose."
)
_STALLING = (
    "gradients of the networks are summed in half precision here, where sums stall after some thousand "
    "terms. Use few paths at a time, train with `ndf-mi optimise --integrator prbvolpath`, which sums in "
    "single precision, or use a CPU."
)
_EXCEEDED = (
    "{excess}. Majorants were raised to hold there, but the estimate has missed fine structure: give the "
    "`ndf_shell` a smaller `cell`, or leave out `layers` for the majorant that holds by construction."
)


def register() -> None:
    """Defines and registers the plugin for the active variant."""

    class Part(mi.Medium):
        """What an ``ndf`` medium and its layers share; each has a `neural_field` and a `majorant` in 1/m."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            return self.neural_field.posed().bbox.ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
            return mi.UnpolarizedSpectrum(self.majorant)

        def get_scattering_coefficients(
            self, mei: mi.MediumInteraction3f, active: mi.Bool = True
        ) -> tuple[mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum]:
            return self.neural_field.coefficients(mei, self.majorant, active)

    class NDFMedium(Part):
        r"""
        .. _medium-ndf:

        Neural deformable field (:monosp:`ndf`)
        ---------------------------------------

        A trained field around a posed body as a participating medium. The field's density is the extinction
        σ_t (1/m), its colour the single-scattering albedo. Under ``ndf_quadrature`` and ``ndf_path`` the
        colour is emitted instead.

        .. pluginparameters::

         * - run
           - |string|
           - Folder of a run, as made by ``ndf-mi optimise``; relative to the working directory or to the
             scene's folder.
         * - frame
           - |int|
           - Frame whose pose the field takes. (Default: the run's first)
         * - offset
           - |vector|
           - Where the performer stands relative to the run, in metres. (Default: 0, 0, 0)
         * - scale
           - |float|
           - Factor on the density. (Default: 1)
         * - grid_spacing
           - |float|
           - Spacing in metres of a grid that the field is sampled on when the scene is loaded and whenever
             its parameters change. Paths look it up instead of running the networks, which is several times
             as fast. 0.003 is fine enough for an adult. (Default: 0, no grid)
         * - (Nested plugin)
           - |phase|
           - Phase function. (Default: isotropic)

         * - weights, grid
           - |float array|
           - The networks' weights, and the hash table where the preset has one.
           - |exposed|, |differentiable|
         * - vertices, pose
           - |float array|
           - The posed body's vertices (flat, metres) and the pose vector (flat axis-angles, radians).
           - |exposed|, |differentiable|

        - Works under ``volpath``, ``volpathmis``, ``prbvolpath``, ``ndf_path`` and ``ndf_quadrature``.
          Integrators that know no media (``path``, ``direct``) show nothing of it;
          :func:`ndf_mi.render.scene_issues.scene_issues` reports them.
        - The majorant is one number, above every density by construction of the density's activation. An
          ``ndf_shell`` with ``layers`` provides local ones, estimated from samples.
        - The density is zero outside the band. Enclose the medium in an ``ndf_shell`` or in any closed shape
          around the band.
        - A shape around the medium does not move with it: after a change of ``vertices``, make a new
          ``ndf_shell``.
        - With ``grid_spacing``, the field is linear between the grid's nodes, colours must not depend on the
          view direction, no gradients reach the parameters, and the majorant follows from the densest node.
          ``ndf_quadrature`` and ``ndf_path`` show the field itself regardless.
        - A sensor inside the medium must name it (``<ref id="…"/>``). ``prbvolpath`` begins outside of media
          even then.
        """

        outermost = True

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            rename_parameter(props, "ndf", "lattice", "grid_spacing")
            self.run = properties.run(props)
            self.frame = properties.frame(self.run, props)
            self.offset = properties.offset(self.run, props)
            self.scale = float(props.get("scale", 1.0))
            if not 0 < self.scale < float("inf"):
                raise InputError("ndf: scale", repr(self.scale), "a number above 0")
            self.grid_spacing = float(props.get("grid_spacing", 0.0))
            if not 0 <= self.grid_spacing < float("inf"):
                expected = "a spacing above 0 in metres, or 0 for no grid"
                raise InputError("ndf: grid_spacing", repr(self.grid_spacing), expected)
            if self.grid_spacing > 0 and self.run.model.field.preset.direction_octaves >= 0:
                found = f"{self.grid_spacing:g}, of a field whose colours depend on the view direction"
                raise InputError("ndf: grid_spacing", found, "0, or a field without that",
                                 "A grid holds one colour for all directions.")
            self.weights, self.grid = mi.Float(self.run.parameters.weights), self.run.parameters.grid
            if self.grid is not None:
                self.grid = mi.Float(self.grid)
            vertices = self.run.poses.vertices[self.run.poses.index(self.frame)]
            self.vertices = mi.Float((vertices + self.offset).ravel())
            self.pose = self.run.pose_vector(self.frame)
            # A literal would be compiled into every kernel, and again for each new value.
            dr.make_opaque(self.weights, self.grid, self.vertices, self.pose)
            self._nested: Majorants | None = None
            self._warned: set[str] = set()
            self._bind(moved=True)

        @property
        def neural_field(self) -> NDFMedium:
            return self

        def posed(self) -> PosedModel:
            return self._model

        def _bind(self, moved: bool) -> None:
            model, parameters = self.run.model, FieldParameters(self.weights, self.grid)
            if moved:
                self._surface = model.pose(self.vertices)
            self._model = PosedModel(model, parameters, self._surface, self.pose)
            self._model.bound.pack()
            # What paths meet: the field, or the grid that it is sampled on.
            self._seen: PosedModel | SparseGrid = self._model
            if self.grid_spacing > 0:
                preset = model.field.preset
                reach = max(preset.band, preset.band_inside)
                self._seen = SparseGrid(self._model, model.surface, self.vertices, reach, self.grid_spacing,
                                        model.bands)
            self.majorant = dr.opaque(mi.Float, self._seen.majorant * self.scale)

        def traverse(self, callback: Any) -> None:
            super().traverse(callback)
            for name in _PARAMETERS:
                if getattr(self, name) is not None:
                    callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            moved = not keys or "vertices" in keys
            self._bind(moved)
            if self._nested is not None and (not keys or not set(_PARAMETERS).isdisjoint(keys)):
                self._follow(self._nested, moved)

        def nest(
            self, layers: int, cell: float
        ) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[mi.Medium]]:
            """See :class:`ndf_mi.render.performers.NeuralField`. Raises InputError if there are shells."""
            if self._nested is not None:
                found = "an `ndf` medium that is inside another `ndf_shell`"
                raise InputError("ndf_shell", found, "a medium of its own for each")
            self._nested = Majorants(self.run.model, self._seen, self.vertices, layers, cell)
            self._adopt(self._nested)
            media = [NDFLayer(self, index) for index in range(len(self._nested.values))]
            return self._nested.layers.shells, media

        def _follow(self, nested: Majorants, moved: bool) -> None:
            """New majorants between the same shells. While gradients are tracked, weights change all the
            time: then the majorant that holds by construction."""
            if moved:
                left_out = nested.left_out(self.vertices)
                if left_out > 0:
                    self._warn("moved", _MOVED.format(share=100 * left_out))
            if self._differentiated():
                self._set_majorants([self._seen.majorant] * len(nested.values))
            else:
                nested.update(self._seen, self.vertices if moved else None)
                self._adopt(nested)

        def _adopt(self, nested: Majorants) -> None:
            self._set_majorants(nested.values)
            if nested.excess is not None:
                self._warn("exceeded", _EXCEEDED.format(excess=nested.excess))

        def _set_majorants(self, values: list[float]) -> None:
            self.layer_majorants = [dr.opaque(mi.Float, value * self.scale) for value in values]

        def _differentiated(self) -> bool:
            return dr.grad_enabled([getattr(self, name) for name in _PARAMETERS])

        def _warn(self, kind: str, text: str) -> None:
            """Logs a warning of each kind once."""
            if kind not in self._warned:
                self._warned.add(kind)
                mi.Log(mi.LogLevel.Warn, f"ndf: {self.run.path}, frame {self.frame}: {text}")

        def coefficients(
            self, mei: mi.MediumInteraction3f, majorant: mi.Float, active: mi.Bool = True
        ) -> tuple[mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum]:
            """(σ_s, σ_n, σ_t) in 1/m under a majorant, where σ_n = majorant − σ_t."""
            if self._seen is not self._model and self._differentiated():
                expected = "none: what is sampled on a grid is detached"
                raise InputError("ndf: grid_spacing", "gradients of parameters", expected,
                                 "Leave out `grid_spacing`.")
            if self._model.bound.half and self._model.bound.attached:
                self._warn("stalling", _STALLING)
            sample = self._seen.fused(mei.p, -mei.wi, active)
            extinction = sample.sigma * self.scale
            coefficients = extinction * sample.colour, majorant - extinction, extinction
            return tuple(mi.UnpolarizedSpectrum(value) for value in coefficients)

        def to_string(self) -> str:
            return (f"NDFMedium[\n  run = {self.run.path},\n  frame = {self.frame},\n"
                    f"  majorant = {self.majorant[0]:.4g}\n]")

    class NDFLayer(Part):
        """The field of an ``ndf`` medium between two nested shells, made by ``ndf_shell``."""

        def __init__(self, field: NDFMedium, index: int) -> None:
            props = mi.Properties("ndf")
            props["phase"] = field.phase_function()
            props["sample_emitters"] = field.use_emitter_sampling()
            super().__init__(props)
            self.index = index
            self.neural_field = field

        @property
        def outermost(self) -> bool:
            return self.index == 0

        @property
        def majorant(self) -> mi.Float:
            return self.neural_field.layer_majorants[self.index]

        def traverse(self, callback: Any) -> None:
            if self.index == 0:
                self.neural_field.traverse(callback)

        def parameters_changed(self, keys: list[str]) -> None:
            self.neural_field.parameters_changed(keys)

        def to_string(self) -> str:
            return (f"NDFLayer[\n  index = {self.index},\n  majorant = {self.majorant[0]:.4g},\n"
                    f"  field = {self.neural_field}\n]")

    mi.register_medium("ndf", lambda props: NDFMedium(props))
