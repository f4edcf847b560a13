"""The medium plugin ``ndf``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters
from ndf_mi.model import PosedModel
from ndf_mi.projection import PosedSurface
from ndf_mi.render import colours
from ndf_mi.render.blocks import Blocks
from ndf_mi.render.nested import Majorants
from ndf_mi.run import Run

_PARAMETERS = {"weights": None, "grid": None, "vertices": None, "pose": None}.keys()
"""What the medium exposes, in this order."""

_MOVED = (
    "the body has moved, and {share:.2g} % of its band lie outside the shells and are not seen. Shells stay where they were made: "
    "load the scene anew at this pose."
)
_STALLING = (
    "gradients of the networks are summed in half precision here, where sums stall after some thousand terms. Take few paths at a time, "
    "train by `ndf-mi optimise --integrator prbvolpath`, which sums in single precision, or use a CPU"
)
_EXCEEDED = (
    "{excess}. Majorants were raised to hold there, but the estimate has missed fine structure: give the `ndf_shell` a smaller "
    "`cell`, or leave `layers` out for the majorant that holds by construction."
)


def find_run(path: str) -> Path:
    """The folder of a run named in a scene: as given, or relative to the scene's own folder."""
    if os.path.isdir(path):
        return Path(path)
    return Path(str(mi.file_resolver().resolve(path)))


def frame_of(run: Run, props: mi.Properties) -> int:
    """The frame that a plugin's properties name, by default the run's first."""
    return int(props.get("frame", int(run.poses.frames[0])))


def offset_of(run: Run, props: mi.Properties) -> np.ndarray:
    """(3,) float32: how far a plugin's properties have the performer moved, in metres.

    Raises:
        InputError: it is not finite, or the run's networks take world coordinates, in which a moved performer would be another one.
    """
    offset = np.array(props.get("offset", mi.ScalarVector3f(0.0)), dtype=np.float32).reshape(-1)
    if offset.size != 3 or not np.isfinite(offset).all():
        raise InputError("ndf: offset", str(offset.tolist()), "three finite numbers, in metres")
    if offset.any() and run.model.field.preset.coordinates == "world":
        raise InputError("ndf: offset", str(offset.tolist()), f"none for {run.path}: its networks take world coordinates")
    return offset


def register() -> None:
    """Defines and registers the plugin for the active variant."""

    class NDFMedium(mi.Medium):
        r"""
        .. _medium-ndf:

        Neural deformable field (:monosp:`ndf`)
        ---------------------------------------

        A trained field around a posed body as a participating medium. The field's density is the extinction σ_t (1/m), its
        colour the single-scattering albedo. Under ``ndf_quadrature`` the colour is emitted instead.

        .. pluginparameters::

         * - run
           - |string|
           - Folder of a run, as made by ``ndf-mi optimise``; relative to the working directory or to the scene's folder.
         * - frame
           - |int|
           - Frame whose pose the field takes. (Default: the run's first)
         * - offset
           - |vector|
           - Where the performer stands, from where the run has them, in metres. (Default: 0, 0, 0)
         * - scale
           - |float|
           - Factor on the density. (Default: 1)
         * - lattice
           - |float|
           - Spacing in metres of a lattice that the field is put onto when the scene is loaded, and whenever its parameters change. Paths
             look that up in place of the networks: several times as quick, detached, and linear in between its nodes. 0.003 is a fine
             one for an adult. (Default: 0, none)
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

        - Works under ``volpath``, ``volpathmis``, ``prbvolpath`` and ``ndf_quadrature``. Integrators that know no media (``path``,
          ``direct``) see nothing of it: :func:`ndf_mi.render.nested_check.faults` tells.
        - The majorant is one number, above every density by construction of the density's activation. An ``ndf_shell`` with
          ``layers`` gives it local ones, estimated from samples.
        - The density is zero outside the band; bound the medium by ``ndf_shell``, or by any closed shape around the band.
        - Does not move a shape around it: after a change of ``vertices``, make a new ``ndf_shell``.
        - On a ``lattice``, colours must not depend on the view direction, no gradients reach the parameters, and the majorant is that of
          the densest node. ``ndf_quadrature`` and ``ndf_path`` show the field itself all the same.
        - A sensor inside the medium names it as its own (``<ref id="…"/>``); ``prbvolpath`` begins outside of media all the same.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False
            self.run = Run.load(find_run(props["run"]))
            self.frame = frame_of(self.run, props)
            self.scale = float(props.get("scale", 1.0))
            if not 0 < self.scale < float("inf"):
                raise InputError("ndf: scale", repr(self.scale), "a number above 0")
            self.lattice = float(props.get("lattice", 0.0))
            if not 0 <= self.lattice < float("inf"):
                raise InputError("ndf: lattice", repr(self.lattice), "a spacing above 0 in metres, or 0 for none")
            if self.lattice > 0 and self.run.model.field.preset.direction_octaves >= 0:
                raise InputError("ndf: lattice", f"{self.lattice:g}, of a field whose colours depend on the view direction",
                                 "none, or a field without that", "A lattice holds one colour for all directions.")
            parameters = self.run.parameters
            self.weights = mi.Float(parameters.weights)
            self.grid = mi.Float(parameters.grid) if parameters.grid is not None else None
            self.offset = offset_of(self.run, props)
            self.vertices = mi.Float((self.run.poses.vertices[self.run.poses.index(self.frame)] + self.offset).ravel())
            self.pose = self.run.pose_vector(self.frame)
            # A literal would be compiled into every kernel, and again at each new value.
            dr.make_opaque(self.weights, self.grid, self.vertices, self.pose)
            self._surface = PosedSurface(self.run.model.surface, self.vertices, self.run.model.band)
            self._nested: Majorants | None = None
            self._told: set[str] = set()
            self._bind()

        def posed(self) -> PosedModel:
            """The field with the parameters that the medium has now; gradients flow to them."""
            return self._model

        def _bind(self) -> None:
            model = self.run.model
            self._model = PosedModel(model, FieldParameters(self.weights, self.grid), self._surface, self.pose)
            self._model.bound.pack()
            self._blocks: Blocks | None = None
            if self.lattice > 0:
                preset = model.field.preset
                self._blocks = Blocks(self._model, model.surface, self.vertices, max(preset.band, preset.band_inside), self.lattice)
            self.majorant = dr.opaque(mi.Float, self._held().majorant * self.scale)

        def _held(self) -> PosedModel | Blocks:
            """What paths are told of: the field, or the lattice that it was put onto."""
            return self._model if self._blocks is None else self._blocks

        def traverse(self, callback: Any) -> None:
            super().traverse(callback)
            for name in _PARAMETERS:
                if getattr(self, name) is not None:
                    callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            moved = not keys or "vertices" in keys
            if moved:
                self._surface = PosedSurface(self.run.model.surface, self.vertices, self.run.model.band)
            self._bind()
            if self._nested is not None and (not keys or not _PARAMETERS.isdisjoint(keys)):
                self._follow(moved)

        def nest(self, layers: int, cell: float) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[mi.Medium]]:
            """Nested shells around the field as it is now, and the medium between each and the next.

            Args:
                layers: number of shells at most.
                cell: spacing in metres of the grid that they are cut from.

            Returns:
                the shells from the outermost on, as vertices and faces, and as many media. These share the field's parameters with this
                one, which the first exposes, and its phase function; their majorants follow changes of the parameters.
            """
            if self._nested is not None:
                raise InputError("ndf_shell", "an `ndf` medium that is inside another `ndf_shell`", "a medium of its own for each")
            self._nested = Majorants(self.run.model, self._held(), self.vertices, layers, cell)
            self._adopt()
            return self._nested.layers.shells, [NDFLayer(self, index) for index in range(len(self._nested.values))]

        def _follow(self, moved: bool) -> None:
            """New majorants between the same shells: while gradients are wanted the one by construction, as weights change all the time."""
            assert self._nested is not None
            if moved:
                left_out = self._nested.left_out(self.vertices)
                if left_out > 0:
                    self._warn("moved", _MOVED.format(share=100 * left_out))
            if self._differentiated():
                self._set_majorants([self._held().majorant] * len(self._nested.values))
                return
            self._nested.update(self._held(), self.vertices if moved else None)
            self._adopt()

        def _differentiated(self) -> bool:
            return any(dr.grad_enabled(value) for name in _PARAMETERS if (value := getattr(self, name)) is not None)

        def _expect_no_gradients(self) -> None:
            if self._blocks is not None and self._differentiated():
                raise InputError("ndf: lattice", "gradients wanted of parameters", "none: what is put onto a lattice is detached",
                                 "Leave `lattice` out.")

        def _set_majorants(self, values: list[float]) -> None:
            self.layer_majorants = [dr.opaque(mi.Float, value * self.scale) for value in values]

        def _adopt(self) -> None:
            assert self._nested is not None
            self._set_majorants(self._nested.values)
            if self._nested.excess is not None:
                self._warn("exceeded", _EXCEEDED.format(excess=self._nested.excess))

        def _warn(self, kind: str, text: str) -> None:
            """Says something once."""
            if kind not in self._told:
                self._told.add(kind)
                mi.Log(mi.LogLevel.Warn, f"ndf: {self.run.path}, frame {self.frame}: {text}")

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            return self._model.bbox.ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
            # Asked for by integrators that scatter, and by no other.
            colours.tell(self.run, scattering=True)
            return mi.UnpolarizedSpectrum(self.majorant)

        def get_scattering_coefficients(
            self, mei: mi.MediumInteraction3f, active: mi.Bool = True
        ) -> tuple[mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum]:
            return self.coefficients(mei, self.majorant, active)

        def coefficients(
            self, mei: mi.MediumInteraction3f, majorant: mi.Float, active: mi.Bool = True
        ) -> tuple[mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum]:
            """(σ_s, σ_n, σ_t) in 1/m, where σ_n is what is missing to the majorant."""
            self._expect_no_gradients()
            if self._model.bound.half and self._model.bound.attached:
                self._warn("stalling", _STALLING)
            sample = self._held().fused(mei.p, -mei.wi, active)
            extinction = sample.sigma * self.scale
            return (mi.UnpolarizedSpectrum(extinction * sample.colour), mi.UnpolarizedSpectrum(majorant - extinction),
                    mi.UnpolarizedSpectrum(extinction))

        def to_string(self) -> str:
            return f"NDFMedium[\n  run = {self.run.path},\n  frame = {self.frame},\n  majorant = {self.majorant[0]:.4g}\n]"

    class NDFLayer(mi.Medium):
        """What lies between two nested shells of an ``ndf`` medium: the same field under a majorant of its own. Made by ``ndf_shell``."""

        def __init__(self, field: NDFMedium, index: int) -> None:
            props = mi.Properties("ndf")
            props["phase"] = field.phase_function()
            props["sample_emitters"] = field.use_emitter_sampling()
            super().__init__(props)
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False
            self.index = index
            self.field = field
            if index == 0:
                # What integrators of the package ask a medium for, once a field.
                self.posed = field.posed

        @property
        def majorant(self) -> mi.Float:
            """The layer's majorant in 1/m."""
            return self.field.layer_majorants[self.index]

        def traverse(self, callback: Any) -> None:
            if self.index == 0:
                self.field.traverse(callback)

        def parameters_changed(self, keys: list[str]) -> None:
            self.field.parameters_changed(keys)

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            return self.field.intersect_aabb(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
            colours.tell(self.field.run, scattering=True)
            return mi.UnpolarizedSpectrum(self.majorant)

        def get_scattering_coefficients(
            self, mei: mi.MediumInteraction3f, active: mi.Bool = True
        ) -> tuple[mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum]:
            return self.field.coefficients(mei, self.majorant, active)

        def to_string(self) -> str:
            return f"NDFLayer[\n  index = {self.index},\n  majorant = {self.majorant[0]:.4g},\n  field = {self.field}\n]"

    mi.register_medium("ndf", lambda props: NDFMedium(props))
