"""A field that is a table: any density and colour for each stratum of each ray, and the quadrature of it in float64."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field.sample import FieldSample, Located

GREY = 0.7


class Slab:
    """A `VolumeField` in the box [0, N] × [0, 1] × [0, length], whose density and colour are constant in equal strata along z.

    Args:
        sigma: (N, S) densities in 1/m, stratum by stratum along z, of the N unit columns along x.
        colour: (N, S) grey values.
        length: along z, in metres.
    """

    sample_factor = 1

    def __init__(self, sigma: np.ndarray, colour: np.ndarray | None = None, length: float = 1.0) -> None:
        self._columns, self._depth = sigma.shape
        self._per_metre = self._depth / length
        self.bbox = mi.BoundingBox3f(mi.Point3f(0, 0, 0), mi.Point3f(float(self._columns), 1, length))
        self.sigma = mi.Float(np.ascontiguousarray(sigma, np.float32).ravel())
        colours = np.full(sigma.shape, GREY) if colour is None else colour
        self.colour = mi.Float(np.ascontiguousarray(colours, np.float32).ravel())
        self.length = length

    def rays(self) -> mi.Ray3f:
        """A ray through the middle of each column, from one length before it."""
        x = mi.Float(np.arange(self._columns) + 0.5)
        ray = mi.Ray3f(mi.Point3f(x, 0.5, -self.length), mi.Vector3f(0, 0, 1))
        ray.d = ray.d + dr.zeros(mi.Vector3f, self._columns)
        return ray

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """Every point may be in the field."""
        return dr.full(mi.Bool, True, dr.width(x))

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """The table's row of each point, as its triangle."""
        column = mi.UInt32(dr.clip(x.x, 0, self._columns - 1))
        located = Located.anywhere(active)
        located.triangle = column * self._depth + mi.UInt32(dr.clip(x.z * self._per_metre, 0, self._depth - 1))
        return located

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """Density alone, detached."""
        return dr.detach(dr.gather(mi.Float, self.sigma, located.triangle, active))

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """Density and colour by the table; attached to it."""
        grey = dr.gather(mi.Float, self.colour, located.triangle, active)
        return FieldSample(dr.gather(mi.Float, self.sigma, located.triangle, active), mi.Color3f(grey), mi.Point3f(x), mi.Normal3f(0, 0, 1))


@dataclass(frozen=True)
class Truth:
    """What rays see of a slab, float64.

    Attributes:
        colour, opacity, depth: (N,).
        by_sigma, by_colour: (N, S) derivatives of colour + opacity of the ray in σ and c of each stratum.
        terms: (N, S) the sum of the magnitudes that make up `by_sigma`.
    """

    colour: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray
    by_sigma: np.ndarray
    by_colour: np.ndarray
    terms: np.ndarray


def integrate(sigma: np.ndarray, colour: np.ndarray, length: float) -> Truth:
    """The quadrature L = Σ T (1 − exp(−σδ)) c of (N, S) tables, in the precision of the arguments, and its derivatives by hand."""
    delta = length / sigma.shape[1]
    with np.errstate(over="ignore", under="ignore"):
        tau = sigma.astype(np.float64) * delta
        after = np.cumsum(tau, 1)
        before = np.concatenate([np.zeros_like(tau[:, :1]), after[:, :-1]], 1)
        weight = np.exp(-before) * -np.expm1(-tau)
        term = weight * colour
        behind = term.sum(1, keepdims=True) - np.cumsum(term, 1)
        behind = np.concatenate([np.cumsum(term[:, :0:-1], 1)[:, ::-1], np.zeros_like(behind[:, :1])], 1)
        own, through = np.exp(-after) * colour, np.exp(-after[:, -1:])
        middle = length + (np.arange(sigma.shape[1]) + 0.5) * delta
        opacity = -np.expm1(-after[:, -1])
        return Truth(term.sum(1), opacity, (weight * middle).sum(1) / np.maximum(opacity, 1e-300),
                     delta * (own - behind + through), weight, delta * (own + behind + through))
