"""A field put onto a lattice that exists only where the field does: blocks of nodes, looked up in place of networks.

Along a path a field is asked for at every collision, null or real, and each time searches the closest point and runs its networks. Where
neither pose nor weights change, a lattice that is fine enough answers the same at a fraction of the time.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.field.sample import FieldSample, Located
from ndf_mi.projection import PosedSurface, Surface
from ndf_mi.render.bake import gathered
from ndf_mi.render.ray_samples import VolumeField

SIDE = 8
"""Cells of a block along each axis. Its nodes are one more: those on its border are its neighbours', too."""

LEAST = 1e-3
"""Blocks that are less dense than this everywhere, in 1/m, are left out: through a metre of them a thousandth of the light is lost."""

LARGEST = 1 << 28
"""Numbers that a lattice may hold: a GiB of them."""

_NODES = (SIDE + 1) ** 3
_CHUNK = 256
"""Blocks that are evaluated at once; the last are filled up, as their number is compiled into kernels."""
_MARGIN = 1.05
_FLOOR = 0.05
"""Least majorant in 1/m: free flights divide by it."""


class Blocks:
    """σ_t and albedo of a field, linear along each axis between the nodes of a lattice; zero where there are no blocks.

    Linear are σ_t and σ_s, of which the albedo is the ratio. Detached. The lattice answers what majorants are estimated by and what a
    medium asks for, as the field itself does.

    Args:
        volume: the field at its pose; its colours must not depend on the view direction.
        surface: the body's.
        vertices: flat (3·V), where the body is, in metres.
        reach: how far from it the field may be anything but empty, in metres.
        cell: from one node to the next, metres.

    Attributes:
        majorant: 1.05 times the densest node, in 1/m: interpolation exceeds no node.
        blocks: how many there are.

    Raises:
        InputError: so many blocks would not fit into memory.
    """

    sample_factor = 1
    """Looking up needs no more candidate samples than asked for."""

    def __init__(self, volume: VolumeField, surface: Surface, vertices: mi.Float, reach: float, cell: float) -> None:
        self.cell = cell
        low, high = (np.array(corner, np.float64).ravel() for corner in (volume.bbox.min, volume.bbox.max))
        self.bbox = volume.bbox
        self._shape = tuple(int(n) for n in np.ceil((high - low) / (SIDE * cell)))
        if np.prod(self._shape, dtype=np.float64) > LARGEST:
            raise InputError("lattice", f"a spacing of {cell:g} m", "a larger one: the lattice would not fit into memory")
        self._low = mi.Point3f(*low.tolist())
        dr.make_opaque(self._low)
        with dr.suspend_grad():
            chosen = self._chosen(surface, vertices, reach)
            if 4 * _NODES * len(chosen) > LARGEST:
                fitting = cell * (4 * _NODES * len(chosen) / LARGEST) ** (1 / 3)
                raise InputError("lattice", f"a spacing of {cell:g} m, {16e-9 * _NODES * len(chosen):.2g} GB",
                                 f"a GiB at most: about {fitting:.2g} m")
            kept, values = self._filled(volume, chosen)
        table = np.zeros(int(np.prod(self._shape)), np.uint32)
        table[kept] = 1 + np.arange(len(kept))
        self.blocks = len(kept)
        self._table, self._nodes = mi.UInt32(table), mi.Float(values)
        self.majorant = max(float(values[::4].max()) * _MARGIN, _FLOOR)

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """True: looking up is no dearer than asking."""
        return dr.full(mi.Bool, True, dr.width(x))

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """Every active point is valid."""
        return Located.anywhere(mi.Bool(active) & dr.full(mi.Bool, True, dr.width(x)))

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """σ at points in 1/m."""
        return self.fused(x, mi.Vector3f(0.0), active).sigma

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """The lattice at points; coordinates and normals are zero."""
        return self.fused(x, d, active)

    def fused(self, x: mi.Point3f, d: mi.Vector3f, active: mi.Bool | bool = True) -> FieldSample:
        """The same."""
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
            node = dr.gather(mi.Vector4f, self._nodes, first + ((k * (SIDE + 1) + j) * (SIDE + 1) + i), active)
            total += weight * node
        albedo = mi.Color3f(total.y, total.z, total.w) / dr.maximum(total.x, 1e-30)
        return FieldSample(total.x, albedo, dr.zeros(mi.Point3f), dr.zeros(mi.Normal3f))

    def _chosen(self, surface: Surface, vertices: mi.Float, reach: float) -> np.ndarray:
        """Flat indices of the blocks that come within `reach` of the surface, and of some beside them."""
        bx, by, _ = self._shape
        index = dr.arange(mi.UInt32, int(np.prod(self._shape)))
        middle = self._low + (0.5 + mi.Point3f(index % bx, index // bx % by, index // (bx * by))) * (SIDE * self.cell)
        wide = PosedSurface(surface, dr.detach(vertices), reach + 0.5 * math.sqrt(3.0) * SIDE * self.cell)
        return np.flatnonzero(wide.project(middle).valid.numpy())

    def _filled(self, volume: VolumeField, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the chosen blocks those that are not empty, and their nodes: flat (blocks, z, y, x, 4)."""
        bx, by, _ = self._shape
        kept, parts = [], []
        for start in range(0, len(chosen), _CHUNK):
            some = chosen[start : start + _CHUNK]
            blocks = mi.UInt32(np.resize(some, _CHUNK).astype(np.uint32))

            def at(index: mi.UInt32, blocks: mi.UInt32 = blocks) -> mi.Point3f:
                block, node = dr.gather(mi.UInt32, blocks, index // _NODES), index % _NODES
                corner = SIDE * mi.Point3f(block % bx, block // bx % by, block // (bx * by))
                within = mi.Point3f(node % (SIDE + 1), node // (SIDE + 1) % (SIDE + 1), node // (SIDE + 1) ** 2)
                return self._low + self.cell * (corner + within)

            index, located, real = gathered(volume, at, dr.arange(mi.UInt32, _CHUNK * _NODES) < dr.opaque(mi.UInt32, len(some) * _NODES))
            sample = volume.evaluate(at(index), mi.Vector3f(dr.zeros(mi.Float, dr.width(index)), 0.0, 1.0), located, real)
            nodes = dr.zeros(mi.Float, 4 * _CHUNK * _NODES)
            for channel, value in enumerate((sample.sigma, *(sample.sigma * c for c in sample.colour))):
                dr.scatter(nodes, value, 4 * index + channel, real, mode=dr.ReduceMode.Permute)
            values = nodes.numpy().reshape(_CHUNK, -1)[: len(some)]
            dense = values[:, ::4].max(1) >= LEAST
            kept.append(some[dense])
            parts.append(values[dense])
        return (np.concatenate([*kept, np.zeros(0, np.int64)]),
                np.concatenate([*parts, np.zeros((0, 4 * _NODES), np.float32)]).ravel() if any(map(len, kept)) else np.zeros(4, np.float32))
