"""A field put onto a lattice: evaluated at the nodes that lie in it, by batched networks, attached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ndf_mi.field.sample import Located
from ndf_mi.render.ray_samples import VolumeField
from ndf_mi.render.sampling import compact


@dataclass
class Baked:
    """A field at a lattice's nodes.

    Attributes:
        values: K lanes of σ_t and of σ_s, red, green and blue, in 1/m; attached to the field's parameters.
        index, real: K; the node of each lane, and whether it is one or padding.
        nodes: flat (nz, ny, nx, 4) of the whole lattice, detached, zero at all other nodes.
        densest: the largest σ_t, one number.
    """

    values: tuple[mi.Float, mi.Float, mi.Float, mi.Float]
    index: mi.UInt32
    real: mi.Bool
    nodes: mi.Float
    densest: mi.Float

    def vjp(self, adjoint: mi.Float) -> mi.Float:
        """One number whose derivatives in the field's parameters are those of a function that has the derivatives `adjoint` in `nodes`."""
        total = mi.Float(0.0)
        for channel, value in enumerate(self.values):
            total = total + dr.sum(value * dr.gather(mi.Float, adjoint, 4 * self.index + channel, self.real))
        return total


def gathered(volume: VolumeField, at: Callable[[mi.UInt32], mi.Point3f], candidates: mi.Bool) -> tuple[mi.UInt32, Located, mi.Bool]:
    """The nodes that lie in a field, of those that are candidates; detached.

    Args:
        at: positions of nodes.
        candidates: which of them to look at, one lane each.

    Returns:
        K lanes: the node, where it lies, and whether the lane is one or padding.
    """
    with dr.suspend_grad():
        chosen, real, _ = compact(candidates & volume.may_contain(at(dr.arange(mi.UInt32, dr.width(candidates)))))
        located = volume.locate(at(chosen), real)
        located.valid &= real
        dr.eval(located)
        second, real, _ = compact(located.valid)
        index, located = dr.gather(mi.UInt32, chosen, second), dr.gather(Located, located, second)
        dr.eval(index, located)
    return index, located, real


def bake(volume: VolumeField, low: mi.Point3f, cell: float, shape: tuple[int, int, int]) -> Baked:
    """Evaluates `volume` at the inner nodes of a lattice; the outermost stay empty. Colours must not depend on the view direction.

    Args:
        low: position of the first node.
        cell: from one node to the next, metres.
        shape: nodes along x, y and z.
    """
    nx, ny, nz = shape
    count = nx * ny * nz

    def at(index: mi.UInt32) -> mi.Point3f:
        row = index // nx
        layer = row // ny
        return low + cell * mi.Point3f(mi.Float(index - row * nx), mi.Float(row - layer * ny), mi.Float(layer))

    with dr.suspend_grad():
        index = dr.arange(mi.UInt32, count)
        row = index // nx
        layer, i, j = row // ny, index - row * nx, row % ny
        inner = (i > 0) & (i < nx - 1) & (j > 0) & (j < ny - 1) & (layer > 0) & (layer < nz - 1)
    index, located, real = gathered(volume, at, inner)
    direction = mi.Vector3f(dr.zeros(mi.Float, dr.width(index)), 0.0, 1.0)
    sample = volume.evaluate(at(index), direction, located, real)
    values = (sample.sigma, *(sample.sigma * channel for channel in sample.colour))
    with dr.suspend_grad():
        nodes = dr.zeros(mi.Float, 4 * count)
        for channel, value in enumerate(values):
            dr.scatter(nodes, dr.detach(value), 4 * index + channel, real, mode=dr.ReduceMode.Permute)
        densest = dr.max(dr.select(real, dr.detach(sample.sigma), 0.0))
        dr.eval(nodes, densest)
    return Baked(values, index, real, nodes, densest)
