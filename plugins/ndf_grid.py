"""The medium plugin ``ndf_grid``, formerly ``ndf_lattice``."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from ndf_mi.deprecated import warn
from ndf_mi.errors import InputError
from ndf_mi.render.majorant import FLOOR
from ndf_mi.render.sparse_grid import MARGIN


def register() -> None:
    """Defines and registers the plugin for the active variant."""

    class GridMedium(mi.Medium):
        r"""
        .. _medium-ndf_grid:

        Medium on a grid (:monosp:`ndf_grid`)
        -------------------------------------

        Extinction and scattering coefficient at the nodes of a grid, linear in between along each axis, zero
        outside. Training through scattering samples a field on it once a step; paths then look it up many
        times. Unlike Mitsuba's ``heterogeneous`` with grid volumes, it can be moved without compiling
        anything, and its majorant is strictly above the density, as gradients need it to be.

        .. pluginparameters::

         * - nx, ny, nz
           - |int|
           - Nodes along each axis, at least 2.
         * - cell
           - |float|
           - Distance in metres from one node to the next.
         * - (Nested plugin)
           - |phase|
           - Phase function. (Default: isotropic)

        - The nodes' values are set from Python, with ``fill``.
        - Works under ``volpath``, ``volpathmis`` and ``prbvolpath``, in any closed shape.
        - The majorant is 1.05 times the largest density at a node, as interpolation exceeds no node.
        - The old name ``ndf_lattice`` still works.
        """

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False
            self.shape = (int(props["nx"]), int(props["ny"]), int(props["nz"]))
            self.cell = float(props["cell"])
            if min(self.shape) < 2:
                raise InputError("ndf_grid: nx, ny, nz", repr(self.shape), "at least 2 each")
            if not 0 < self.cell < float("inf"):
                raise InputError("ndf_grid: cell", repr(self.cell), "a length above 0, in metres")
            nx, ny, nz = self.shape
            self._texture = mi.Texture3f((nz, ny, nx), 4, use_accel=False, wrap_mode=dr.WrapMode.Clamp)
            self.fill(dr.zeros(mi.Float, 4 * nx * ny * nz), mi.Point3f(0.0), mi.Float(0.0))

        def fill(self, nodes: mi.Float, low: mi.Point3f, densest: mi.Float) -> None:
            """Sets the nodes' values; gradients flow to them.

            Args:
                nodes: flat (nz, ny, nx, 4): σ_t and the three channels of σ_s, in 1/m. Zero on the border;
                    other values would continue outside.
                low: position of the first node.
                densest: one number, the largest σ_t at a node or more, in 1/m.
            """
            nx, ny, nz = self.shape
            self._texture.set_tensor(mi.TensorXf(nodes, (nz, ny, nx, 4)))
            low, majorant = mi.Point3f(low), dr.maximum(mi.Float(densest) * MARGIN, FLOOR)
            dr.make_opaque(low, majorant)
            self.low, self.majorant = low, majorant

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            high = self.low + self.cell * mi.Vector3f(*(n - 1 for n in self.shape))
            return mi.BoundingBox3f(self.low, high).ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> mi.UnpolarizedSpectrum:
            return mi.UnpolarizedSpectrum(self.majorant)

        def get_scattering_coefficients(
            self, mei: mi.MediumInteraction3f, active: mi.Bool = True
        ) -> tuple[mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum, mi.UnpolarizedSpectrum]:
            # The centres of texels are the nodes.
            at = ((mei.p - self.low) / self.cell + 0.5) / mi.Vector3f(*self.shape)
            extinction, *scattering = self._texture.eval(mi.Point3f(at), active)
            return (mi.UnpolarizedSpectrum(*scattering), mi.UnpolarizedSpectrum(self.majorant - extinction),
                    mi.UnpolarizedSpectrum(extinction))

        def to_string(self) -> str:
            return (f"GridMedium[\n  shape = {self.shape},\n  cell = {self.cell:g},\n"
                    f"  majorant = {self.majorant[0]:.4g}\n]")

    def formerly(props: mi.Properties) -> GridMedium:
        warn("plugin ndf_lattice", "ndf_grid")
        return GridMedium(props)

    mi.register_medium("ndf_grid", lambda props: GridMedium(props))
    mi.register_medium("ndf_lattice", formerly)
