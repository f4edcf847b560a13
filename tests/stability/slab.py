"""A field given by a table, and its quadrature in float64."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.field.sample import FieldSample, Located

GREY = 0.7


class Slab:
    """A `VolumeField` in the box [0, N] × [0, 1] × [0, length], constant in equal intervals along z.

    Args:
        sigma: (N, S) densities in 1/m of N unit columns along x, interval by interval.
        colour: (N, S) grey values; GREY by default.
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
        """A ray through the middle of each column, starting one length in front of it."""
        x = mi.Float(np.arange(self._columns) + 0.5)
        ray = mi.Ray3f(mi.Point3f(x, 0.5, -self.length), mi.Vector3f(0, 0, 1))
        ray.d = ray.d + dr.zeros(mi.Vector3f, self._columns)
        return ray

    def may_contain(self, x: mi.Point3f) -> mi.Bool:
        """True everywhere."""
        return dr.full(mi.Bool, True, dr.width(x))

    def locate(self, x: mi.Point3f, active: mi.Bool) -> Located:
        """The index of each point in the table, as its triangle."""
        column = mi.UInt32(dr.clip(x.x, 0, self._columns - 1))
        located = Located.anywhere(active)
        located.triangle = column * self._depth + mi.UInt32(
            dr.clip(x.z * self._per_metre, 0, self._depth - 1))
        return located

    def density(self, x: mi.Point3f, located: Located, active: mi.Bool) -> mi.Float:
        """Densities from the table, detached."""
        return dr.detach(dr.gather(mi.Float, self.sigma, located.triangle, active))

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, located: Located, active: mi.Bool) -> FieldSample:
        """Densities and colours from the table, attached to it."""
        sigma, grey = (
            dr.gather(mi.Float, values, located.triangle, active) for values in (self.sigma, self.colour))
        return FieldSample(sigma, mi.Color3f(grey), mi.Point3f(x), mi.Normal3f(0, 0, 1))


@dataclass(frozen=True)
class Truth:
    """What N rays see of a slab, float64.

    Attributes:
        colour, opacity, depth: (N,).
        by_sigma, by_colour: (N, S) derivatives of colour + opacity in the density and colour of each
            interval.
        terms: (N, S) sum of the magnitudes that `by_sigma` is a sum of.
    """

    colour: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray
    by_sigma: np.ndarray
    by_colour: np.ndarray
    terms: np.ndarray


def integrate(sigma: np.ndarray, colour: np.ndarray, length: float) -> Truth:
    """The quadrature L = Σ T (1 − exp(−σδ)) c of (N, S) tables and its derivatives."""
    delta = length / sigma.shape[1]
    with np.errstate(over="ignore", under="ignore"):
        tau = sigma.astype(np.float64) * delta
        after = np.cumsum(tau, 1)
        before = np.concatenate([np.zeros_like(tau[:, :1]), after[:, :-1]], 1)
        weight = np.exp(-before) * -np.expm1(-tau)
        behind = sum_behind(weight * colour)
        own, through = np.exp(-after) * colour, np.exp(-after[:, -1:])
        middle = length + (np.arange(sigma.shape[1]) + 0.5) * delta
        opacity = -np.expm1(-after[:, -1])
        return Truth(
            (weight * colour).sum(1), opacity, (weight * middle).sum(1) / np.maximum(opacity, 1e-300),
            delta * (own - behind + through), weight, delta * (own + behind + through))


def integrate_two(first: np.ndarray, second: np.ndarray, red: np.ndarray, blue: np.ndarray) -> tuple[
        np.ndarray, np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Quadrature of two fields with constant optical depths and colours (N, S) in the same intervals.

    L = Σ_i T_i φ(s_i) (τ_1 c_1 + τ_2 c_2), s = τ_1 + τ_2, φ(s) = (1 − e^−s) / s

    Returns:
        Colour and transmittance (N,); for each field the derivatives of colour − transmittance in its optical
        depths, and the sums of the magnitudes of their terms, (N, S).
    """
    total = first + second
    small = total < 1e-4
    safe = np.where(small, 1.0, total)
    phi = np.where(small, 1 - total / 2 + total**2 / 6, -np.expm1(-safe) / safe)
    phi_slope = np.where(small, -0.5 + total / 3, (np.exp(-safe) - phi) / safe)
    after = np.cumsum(total, 1)
    before = np.exp(np.concatenate([np.zeros_like(after[:, :1]), -after[:, :-1]], 1))
    light = first * red + second * blue
    behind, through = sum_behind(before * phi * light), np.exp(-after[:, -1:])
    slopes = [before * (phi * colour + phi_slope * light) - behind + through for colour in (red, blue)]
    terms = [before * (phi * colour + np.abs(phi_slope) * light) + behind + through for colour in (red, blue)]
    return (before * phi * light).sum(1), through[:, 0], slopes, terms


def sum_behind(term: np.ndarray) -> np.ndarray:
    """For each entry of (N, S), the sum of the entries behind it."""
    return np.concatenate([np.cumsum(term[:, :0:-1], 1)[:, ::-1], np.zeros_like(term[:, :1])], 1)
