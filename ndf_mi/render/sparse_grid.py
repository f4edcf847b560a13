"""A field sampled on a grid that exists only where the field does: blocks of nodes, looked up instead of
running networks. Where neither the pose nor the parameters change, it answers in a fraction of the time."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.projection import Bands, PosedSurface, Surface
from ndf_mi.render.bake import sample_nodes
from ndf_mi.render.majorant import FLOOR
from ndf_mi.render.ray_samples import VolumeField

SIDE = 8
"""Cells of a block along each axis. It has one more node than cells; the nodes on its border are its
neighbours' too."""

LEAST = 1e-3
"""Blocks whose density is below this everywhere, in 1/m, are left out: a metre of them absorbs a thousandth
of the light."""

LARGEST = 1 << 28
"""Numbers that a grid may hold: a GiB of them."""

_NODES = (SIDE + 1) ** 3
_CHUNK = 256
"""Blocks evaluated at once. The last chunk is filled up, as its size is compiled into kernels."""
MARGIN = 1.05
"""Factor from the density at the densest node to the majorant."""


class SparseGrid:
    """σ_t and σ_s of a field, linear along each axis between the nodes of a grid; zero where there are no
    blocks. Detached. A `VolumeField` that media and majorants can be made from.

    Args:
        volume: the field at its pose; its colours must not depend on the view direction.
        surface: the body's.
        vertices: flat (3·V), the posed body, in metres.
        reach: how far from the body the field may be anything but empty, in metres.
        cell: distance from one node to the next, metres.
        bands: the widths where they vary over the body; `reach` then is the largest.

    Attributes:
        majorant: 1.05 times the density at the densest node, in 1/m, as interpolation exceeds no node.
        blocks: their number.

    Raises:
        InputError: the grid would take more than a GiB.
    """

    sample_factor = 1
    """A lookup needs no more candidate samples than asked for."""

    def __init__(
        self, volume: VolumeField, surface: Surface, vertices: mi.Float, reach: float, cell: float,
        bands: Bands | None = None,
    ) -> None:
        self.cell = cell
        low, high = (np.array(corner, np.float64).ravel() for corner in (volume.bbox.min, volume.bbox.max))
        self.bbox = volume.bbox
        self._shape = tuple(int(n) for n in np.ceil((high - low) / (SIDE * cell)))
        if np.prod(self._shape, dtype=np.float64) > LARGEST:
            expected = "a larger spacing: the grid would not fit into memory"
            raise InputError("grid_spacing", f"{cell:g} m", expected)
        self._low = mi.Point3f(*low.tolist())
        dr.make_opaque(self._low)
        with dr.suspend_grad():
            candidates = self._candidates(surface, vertices, reach, bands)
            if 4 * _NODES * len(candidates) > LARGEST:
                fitting = cell * (4 * _NODES * len(candidates) / LARGEST) ** (1 / 3)
                found = f"{cell:g} m, which takes {16e-9 * _NODES * len(candidates):.2g} GB"
                raise InputError("grid_spacing", found, f"a GiB at most: about {fitting:.2g} m")
            kept, values = self._filled(volume, candidates)
        table = np.zeros(int(np.prod(self._shape)), np.uint32)
        table[kept] = 1 + np.arange(len(kept))
        self.blocks = len(kept)
        self._table, self._nodes = mi.UInt32(table), mi.Float(values)
        self.majorant = max(float(values[::4].max()) * MARGIN, FLOOR)

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """True: a lookup costs no more than a test."""
        return dr.full(mi.Bool, True, dr.width(x))

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """Every active point is valid."""
        return Located.anywhere(mi.Bool(active) & dr.full(mi.Bool, True, dr.width(x)))

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """σ_t at points in 1/m."""
        return self.fused(x, mi.Vector3f(0.0), active).sigma

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """As :meth:`fused`."""
        return self.fused(x, d, active)

    def fused(self, x: mi.Point3f, d: mi.Vector3f, active: mi.Bool | bool = True) -> FieldSample:
        """Density and albedo at points; texture coordinates and normals are zero."""
        bx, by, bz = self._shape
        q = (x - self._low) / self.cell
        # A NaN is in no block.
        active = mi.Bool(active) & dr.all((q >= 0) & (q < mi.Point3f(*(SIDE * n for n in self._shape))))
        q = dr.select(active, q, 0.0)
        whole = mi.Point3u(q)
        part = q - mi.Point3f(whole)
        block, local = whole // SIDE, whole % SIDE
        slot = dr.gather(mi.UInt32, self._table, (block.z * by + block.y) * bx + block.x, active)
        active &= slot > 0
        first = (slot - 1) * _NODES + (local.z * (SIDE + 1) + local.y) * (SIDE + 1) + local.x
        total = mi.Vector4f(0.0)
        for corner in range(8):
            i, j, k = corner & 1, corner >> 1 & 1, corner >> 2
            weight = mi.Float(1.0)
            for step, along in zip((i, j, k), part, strict=True):
                weight *= along if step else 1.0 - along
            node = first + ((k * (SIDE + 1) + j) * (SIDE + 1) + i)
            total += weight * dr.gather(mi.Vector4f, self._nodes, node, active)
        albedo = mi.Color3f(total.y, total.z, total.w) / dr.maximum(total.x, 1e-30)
        return FieldSample(total.x, albedo, dr.zeros(mi.Point3f), dr.zeros(mi.Normal3f))

    def _place(self, block: mi.UInt32) -> mi.Point3f:
        """A block's position in blocks, by its flat index."""
        bx, by, _ = self._shape
        return mi.Point3f(block % bx, block // bx % by, block // (bx * by))

    def _candidates(self, surface: Surface, vertices: mi.Float, reach: float,
                    bands: Bands | None) -> np.ndarray:
        """Flat indices of the blocks that come within `reach` of the surface, and of some nearby ones."""
        index = dr.arange(mi.UInt32, int(np.prod(self._shape)))
        centre = self._low + (0.5 + self._place(index)) * (SIDE * self.cell)
        half = 0.5 * math.sqrt(3.0) * SIDE * self.cell
        wide = PosedSurface(surface, dr.detach(vertices), reach + half)
        if bands is not None:
            return np.flatnonzero(wide.within_bands(centre, bands, half)[0].numpy())
        return np.flatnonzero(wide.project(centre).valid.numpy())

    def _filled(self, volume: VolumeField, candidates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The candidate blocks that are not empty, and their nodes: flat (blocks, z, y, x, 4)."""
        side = SIDE + 1
        kept, parts = [np.zeros(0, np.int64)], [np.zeros((0, 4 * _NODES), np.float32)]
        for start in range(0, len(candidates), _CHUNK):
            some = candidates[start : start + _CHUNK]
            blocks = mi.UInt32(np.resize(some, _CHUNK).astype(np.uint32))

            def at(index: mi.UInt32, blocks: mi.UInt32 = blocks) -> mi.Point3f:
                corner = SIDE * self._place(dr.gather(mi.UInt32, blocks, index // _NODES))
                node = index % _NODES
                local = mi.Point3f(node % side, node // side % side, node // side**2)
                return self._low + self.cell * (corner + local)

            used = dr.arange(mi.UInt32, _CHUNK * _NODES) < dr.opaque(mi.UInt32, len(some) * _NODES)
            values = sample_nodes(volume, at, used).spread(_CHUNK * _NODES).numpy()
            values = values.reshape(_CHUNK, -1)[: len(some)]
            dense = values[:, ::4].max(1) >= LEAST
            kept.append(some[dense])
            parts.append(values[dense])
        nodes = np.concatenate(parts).ravel()
        return np.concatenate(kept), nodes if len(nodes) else np.zeros(4, np.float32)
