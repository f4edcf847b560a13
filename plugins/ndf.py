"""The medium plugin ``ndf``."""

from __future__ import annotations

import copy
import os
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from ndf_mi.errors import InputError
from ndf_mi.model import PosedModel
from ndf_mi.run import Run


def find_run(path: str) -> Path:
    """The folder of a run named in a scene: as given, or relative to the scene's own folder."""
    if os.path.isdir(path):
        return Path(path)
    return Path(str(mi.file_resolver().resolve(path)))


def frame_of(run: Run, props: mi.Properties) -> int:
    """The frame that a plugin's properties name, by default the run's first."""
    return int(props.get("frame", int(run.poses.frames[0])))


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
         * - scale
           - |float|
           - Factor on the density. (Default: 1)
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

        - Works under ``volpath``, ``volpathmis``, ``prbvolpath`` and ``ndf_quadrature``.
        - The majorant is one number, above every density by construction of the density's activation.
        - The density is zero outside the band; bound the medium by ``ndf_shell``, or by any closed shape around the band.
        - Does not move a shape around it: after a change of ``vertices``, make a new ``ndf_shell``.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False
            self.run = Run.load(find_run(props["run"]))
            self.frame = frame_of(self.run, props)
            self.scale = float(props.get("scale", 1.0))
            if not self.scale > 0:
                raise InputError("ndf: scale", repr(self.scale), "a number above 0")
            field = self.run.model.field
            self.weights = mi.Float(field.weights)
            self.grid = mi.Float(field.grid) if field.grid is not None else None
            self.vertices = mi.Float(self.run.poses.vertices[self.run.poses.index(self.frame)].ravel())
            self.pose = self.run.pose_vector(self.frame)
            # A literal would be compiled into every kernel, and again at each new value.
            dr.make_opaque(self.weights, self.grid, self.vertices, self.pose)
            self._surface = self.run.model.surface.pose(self.vertices, self.run.model.band)
            self._bind()

        def posed(self) -> PosedModel:
            """The field with the parameters that the medium has now; gradients flow to them."""
            return self._model

        def _bind(self) -> None:
            model = copy.copy(self.run.model)
            model.field = copy.copy(model.field)
            model.field.weights, model.field.grid = self.weights, self.grid
            self._model = PosedModel(model, self._surface, self.pose)
            self._model.bound.pack()

        def traverse(self, callback: Any) -> None:
            super().traverse(callback)
            for name in ("weights", "grid", "vertices", "pose"):
                if getattr(self, name) is not None:
                    callback.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys: list[str]) -> None:
            if not keys or "vertices" in keys:
                self._surface = self.run.model.surface.pose(self.vertices, self.run.model.band)
            self._bind()

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            return self._model.bbox.ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
            return mi.UnpolarizedSpectrum(self._model.majorant * self.scale)

        def get_scattering_coefficients(
            self, mei: mi.MediumInteraction3f, active: mi.Bool = True
        ) -> tuple[mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum]:
            sample = self._model.fused(mei.p, -mei.wi, active)
            extinction = sample.sigma * self.scale
            majorant = self._model.majorant * self.scale
            return (mi.UnpolarizedSpectrum(extinction * sample.colour), mi.UnpolarizedSpectrum(majorant - extinction),
                    mi.UnpolarizedSpectrum(extinction))

        def to_string(self) -> str:
            return f"NDFMedium[\n  run = {self.run.path},\n  frame = {self.frame},\n  majorant = {self._model.majorant * self.scale}\n]"

    mi.register_medium("ndf", lambda props: NDFMedium(props))
