"""The quadrature along a ray: optical depths, numbers of samples, densities next to nothing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.numerics import expm1, log1p, softplus
from ndf_mi.render.quadrature import Radiance, quadrature
from ndf_mi.render.transport import Performer, Transport
from ndf_mi.stability.case import Measured, case, error
from ndf_mi.stability.network64 import logistic
from ndf_mi.stability.slab import Slab, Truth, integrate

TERMS = "the terms' sum: what a segment adds less what it hides"


def through(slab: Slab, samples: int) -> tuple[Radiance, np.ndarray, np.ndarray]:
    """What a slab's rays see, and the derivatives of the sum of colour and opacity in its densities and colours, flat."""
    dr.enable_grad(slab.sigma, slab.colour)
    seen = quadrature(slab, slab.rays(), samples)
    dr.backward(dr.sum(seen.colour.x + seen.opacity))
    return seen, dr.grad(slab.sigma).numpy(), dr.grad(slab.colour).numpy()


def compare(at: str, slab: Slab, seen: Radiance, gradients: tuple[np.ndarray, np.ndarray], truth: Truth, rows: slice) -> Measured:
    """Errors of some of a slab's rays."""
    shape = truth.by_sigma.shape
    by_sigma, by_colour = (gradient.reshape(shape)[rows] for gradient in gradients)
    opacity = truth.opacity[rows]
    deep = opacity > 1e-5
    return Measured(
        at,
        max(error(seen.colour.x.numpy()[rows], truth.colour[rows]), error(seen.opacity.numpy()[rows], opacity),
            error(seen.depth.numpy()[rows][deep], truth.depth[rows][deep])),
        max(error(by_sigma, truth.by_sigma[rows], truth.terms[rows]), error(by_colour, truth.by_colour[rows])))


@case("optical depth of a segment: colour, opacity, depth; thick before, between and behind thin ones", "1e-38 to 1e38", relative_to=TERMS)
def optical_depth() -> Iterator[Measured]:
    """Patterns of eight segments, of which some have the optical depth in question, the others 0, 1e-3, 1 or its inverse."""
    decades = np.arange(-38, 39)
    x = 10.0**decades[:, None, None]
    ones = np.ones_like(x)
    patterns = [[x] * 8, [x, 0 * x, x, 1e-3 * ones, x, ones, x, 0 * x], [ones, x] * 4, [1e-3 * ones] * 4 + [x] * 4,
                [x, 1 / x] * 4, [0 * x] * 7 + [x]]
    tau = np.concatenate([np.concatenate(pattern, 2) for pattern in patterns], 1).reshape(-1, 8)
    length = 8.0
    colour = np.tile(np.linspace(0.1, 0.9, 8), (len(tau), 1)).astype(np.float32)
    slab = Slab(tau, colour, length)
    truth = integrate(tau.astype(np.float32), colour, length)
    seen, *gradients = through(slab, 8)
    for index, decade in enumerate(decades):
        rows = slice(index * len(patterns), (index + 1) * len(patterns))
        yield compare(f"1e{decade}", slab, seen, (gradients[0], gradients[1]), truth, rows)


@case("segments of optical depth 1 of any length", "1e-6 to 1e6 m", relative_to=TERMS)
def segment_length() -> Iterator[Measured]:
    """σδ is what matters: neither a length nor a density alone is too large or too small."""
    for decade in range(-6, 7):
        length = float(np.float32(10.0**decade))
        sigma = np.full((3, 4), 4 / length).astype(np.float32) * np.array([[0.1], [1], [3]], np.float32)
        slab = Slab(sigma, None, length)
        seen, *gradients = through(slab, 4)
        truth = integrate(sigma, slab.colour.numpy()[0], length)
        yield compare(f"1e{decade} m", slab, seen, (gradients[0], gradients[1]), truth, slice(None))


@case("number of samples a ray", "1 to 100,000", relative_to=TERMS)
def samples_a_ray() -> Iterator[Measured]:
    """Three rays through a density that waves, of optical depth 0.01, 3 and 30."""
    for samples in (1, 10, 64, 100, 257, 1000, 9973, 10_000, 100_000):
        wave = 1 + np.sin(0.3 + 9 * (np.arange(samples) + 0.5) / samples)
        sigma = (np.array([[0.01], [3.0], [30.0]]) * wave).astype(np.float32)
        slab = Slab(sigma)
        seen, *gradients = through(slab, samples)
        yield compare(f"{samples}", slab, seen, (gradients[0], gradients[1]), integrate(sigma, slab.colour.numpy()[0], 1.0), slice(None))


@case("density exactly zero and just above it, alone and among others", "0 and 1e-45 to 1e-30 per metre", relative_to=TERMS)
def density_zero() -> Iterator[Measured]:
    """Where there is nothing the gradient is what the first of it would add, not zero."""
    for density in (0.0, *(10.0**decade for decade in range(-45, -29))):
        sigma = np.array([[1, 1, 1, 1], [1, 0, 1, 0], [0, 0, 0, 1]]) * density + np.array([[0.0], [0.0], [2.0]]) * [1, 0, 1, 0]
        sigma = sigma.astype(np.float32)
        slab = Slab(sigma)
        seen, *gradients = through(slab, 4)
        yield compare(f"{density:g}", slab, seen, (gradients[0], gradients[1]), integrate(sigma, slab.colour.numpy()[0], 1.0), slice(None))


@case("two fields that overlap, as ndf_path sees them: colour, transmittance", "optical depths of a stratum of 1e-38 to 1e38",
      relative_to=TERMS + ", the largest of a ray, at least 1e-12")
def overlapping_fields() -> Iterator[Measured]:
    """Two slabs in one place, the first of the optical depth in question, the second of it, its inverse, 0 or 1."""
    decades = np.arange(-38, 39)
    x = 10.0**decades[:, None, None]
    ones = np.ones_like(x)
    seconds = [[x] * 8, [ones] * 8, [0 * x] * 8, [x, 1 / x] * 4, [ones, 0 * x] * 4]
    second = np.concatenate([np.concatenate(pattern, 2) for pattern in seconds], 1).reshape(-1, 8).astype(np.float32)
    first = np.broadcast_to(x, (len(x), len(seconds), 8)).reshape(-1, 8) * np.tile([1, 0, 1, 1, 0, 1, 0, 1], (len(second), 1))
    first = first.astype(np.float32)
    red, blue = (np.tile(np.linspace(*ends, 8), (len(first), 1)).astype(np.float32) for ends in ((0.1, 0.9), (0.7, 0.2)))
    slabs = Slab(first, red, 8.0), Slab(second, blue, 8.0)
    dr.enable_grad([slab.sigma for slab in slabs])
    ray = slabs[0].rays()
    seen = Transport(8)([Performer(slab) for slab in slabs], ray)
    dr.backward(dr.sum(seen.colour.x - seen.transmittance))
    truth, through, slopes, terms = together(first.astype(np.float64), second.astype(np.float64), red, blue)
    found = [dr.grad(slab.sigma).numpy().reshape(first.shape) for slab in slabs]
    for index, decade in enumerate(decades):
        rows = slice(index * len(seconds), (index + 1) * len(seconds))
        primal = max(error(seen.colour.x.numpy()[rows], truth[rows]), error(seen.transmittance.numpy()[rows], through[rows]))
        yield Measured(f"1e{decade}", primal, max(error(ours[rows], slope[rows], np.maximum(term[rows].max(1, keepdims=True), 1e-12))
                                                  for ours, slope, term in zip(found, slopes, terms, strict=True)))


def together(first: np.ndarray, second: np.ndarray, red: np.ndarray, blue: np.ndarray) -> tuple[
        np.ndarray, np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Colour and transmittance (N,) of two fields of constant optical depths and colours in the same strata, (N, S); the derivatives of
    colour − transmittance in both optical depths, and the sums of their terms' magnitudes.

    L = Σ_i T_i φ(s_i) (τ_1 c_1 + τ_2 c_2), s = τ_1 + τ_2, φ(s) = (1 − e^−s) / s
    """
    total = first + second
    small = total < 1e-4
    safe = np.where(small, 1.0, total)
    phi = np.where(small, 1 - total / 2 + total**2 / 6, -np.expm1(-safe) / safe)
    rise = np.where(small, -0.5 + total / 3, (np.exp(-safe) - phi) / safe)
    after = np.cumsum(total, 1)
    before = np.concatenate([np.zeros_like(after[:, :1]), after[:, :-1]], 1)
    light = first * red + second * blue
    term = np.exp(-before) * phi * light
    behind = np.concatenate([np.cumsum(term[:, :0:-1], 1)[:, ::-1], np.zeros_like(term[:, :1])], 1)
    through = np.exp(-after[:, -1:])
    slopes = [np.exp(-before) * (phi * colour + rise * light) - behind + through for colour in (red, blue)]
    terms = [np.exp(-before) * (phi * colour + np.abs(rise) * light) + behind + through for colour in (red, blue)]
    return term.sum(1), through[:, 0], slopes, terms


@case("expm1, log1p and softplus", "1e-38 to 1e38, both signs where defined")
def elementary_functions() -> Iterator[Measured]:
    """Values and derivatives; expm1 up to where float32 ends."""
    for decade in range(-38, 39):
        x = 10.0**decade * np.array([1.0, 2.2, 7.3])
        x = x[x < 3e38].astype(np.float32).astype(np.float64)
        tries: list[tuple[Any, Any, Any, np.ndarray]] = [
            (expm1, np.expm1, np.exp, np.concatenate([-x, x[x <= 80]])),
            (log1p, np.log1p, lambda v: 1 / (1 + v), x),
            (softplus, lambda v: np.logaddexp(0, v), logistic, np.concatenate([x, -x]))]
        primal, gradient = 0.0, 0.0
        for ours, theirs, slope, at in tries:
            value = mi.Float(at)
            dr.enable_grad(value)
            result = ours(value)
            dr.backward(dr.sum(result))
            primal = max(primal, error(result.numpy(), theirs(at)))
            gradient = max(gradient, error(dr.grad(value).numpy(), slope(at)))
        yield Measured(f"1e{decade}", primal, gradient)
