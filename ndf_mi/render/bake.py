"""A field sampled at the nodes of a grid: only nodes in the field are evaluated; attached."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from ndf_mi.field.sample import Located
from ndf_mi.render.ray_samples import VolumeField
from ndf_mi.render.sampling import compact


@dataclass
class NodeSamples:
    """A field at K of a grid's nodes, those that lie in it.

    Attributes:
        index, real: K; the node of each lane, and whether it is one or padding.
        values: K lanes of σ_t and of σ_s, red, green and blue, in 1/m; attached to the field's parameters.
    """

    index: mi.UInt32
    real: mi.Bool
    values: tuple[mi.Float, mi.Float, mi.Float, mi.Float]

    def spread(self, count: int) -> mi.Float:
        """Flat (count, 4) values of all nodes, detached; zero at those that lie outside the field."""
        with dr.suspend_grad():
            nodes = dr.zeros(mi.Float, 4 * count)
            for channel, value in enumerate(self.values):
                index = 4 * self.index + channel
                dr.scatter(nodes, dr.detach(value), index, self.real, mode=dr.ReduceMode.Permute)
            return nodes

    def vjp(self, adjoint: mi.Float) -> mi.Float:
        """Σ adjoint · nodes, attached: its derivatives in the field's parameters are the vector-Jacobian
        product of `adjoint`, the derivatives of some function in the values of all nodes."""
        total = mi.Float(0.0)
        for channel, value in enumerate(self.values):
            total = total + dr.sum(value * dr.gather(mi.Float, adjoint, 4 * self.index + channel, self.real))
        return total


def sample_nodes(
    volume: VolumeField, at: Callable[[mi.UInt32], mi.Point3f], candidates: mi.Bool
) -> NodeSamples:
    """Evaluates a field at those candidate nodes that lie in it: `at` gives the positions of nodes,
    `candidates` has one lane a node. Colours must not depend on the view direction."""
    with dr.suspend_grad():
        every = dr.arange(mi.UInt32, dr.width(candidates))
        chosen, real, _ = compact(candidates & volume.may_contain(at(every)))
        located = volume.locate(at(chosen), real)
        located.valid &= real
        dr.eval(located)
        second, real, _ = compact(located.valid)
        index, located = dr.gather(mi.UInt32, chosen, second), dr.gather(Located, located, second)
        dr.eval(index, located)
    direction = mi.Vector3f(dr.zeros(mi.Float, dr.width(index)), 0.0, 1.0)
    sample = volume.evaluate(at(index), direction, located, real)
    return NodeSamples(index, real, (sample.sigma, *(sample.sigma * channel for channel in sample.colour)))


def bake(
    volume: VolumeField, low: mi.Point3f, cell: float, shape: tuple[int, int, int]
) -> tuple[NodeSamples, mi.Float, mi.Float]:
    """Evaluates `volume` at the inner nodes of a grid; the outermost stay empty. Colours must not depend on
    the view direction.

    Args:
        low: position of the first node.
        cell: distance from one node to the next, metres.
        shape: nodes along x, y and z.

    Returns:
        the samples; all nodes, flat (nz, ny, nx, 4): σ_t and σ_s in 1/m, detached; and the largest σ_t.
    """
    nx, ny, nz = shape

    def place(index: mi.UInt32) -> tuple[mi.UInt32, mi.UInt32, mi.UInt32]:
        row = index // nx
        layer = row // ny
        return index - row * nx, row - layer * ny, layer

    def at(index: mi.UInt32) -> mi.Point3f:
        return low + cell * mi.Point3f(*(mi.Float(part) for part in place(index)))

    with dr.suspend_grad():
        i, j, k = place(dr.arange(mi.UInt32, nx * ny * nz))
        inner = (i > 0) & (i < nx - 1) & (j > 0) & (j < ny - 1) & (k > 0) & (k < nz - 1)
    samples = sample_nodes(volume, at, inner)
    nodes = samples.spread(nx * ny * nz)
    densest = dr.max(dr.select(samples.real, dr.detach(samples.values[0]), 0.0))
    dr.eval(nodes, densest)
    return samples, nodes, densest
