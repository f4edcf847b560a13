"""Quadrature along a ray: optical depths, numbers of samples, vanishing densities; elementary functions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.numerics import expm1, log1p, softplus
from ndf_mi.render.quadrature import quadrature
from ndf_mi.render.transport import Performer, Transport
from ndf_mi.stability.case import Check, case, decades, error
from ndf_mi.stability.curves import logistic
from ndf_mi.stability.slab import Slab, integrate, integrate_two

TERMS = "the sum of the terms: what a segment adds and what it hides"
DECADES = range(-38, 39)


def errors_of(
    sigma: np.ndarray, colour: np.ndarray | None = None, length: float = 1.0) -> list[tuple[float, float]]:
    """Errors of colour, opacity and depth, and of derivatives of colour + opacity, of each ray through a
    slab."""
    slab = Slab(sigma, colour, length)
    dr.enable_grad(slab.sigma, slab.colour)
    seen = quadrature(slab, slab.rays(), sigma.shape[1])
    dr.backward(dr.sum(seen.colour.x + seen.opacity))
    truth = integrate(sigma, slab.colour.numpy().reshape(sigma.shape), length)
    found = seen.colour.x.numpy(), seen.opacity.numpy(), seen.depth.numpy()
    by_sigma, by_colour = (
        dr.grad(values).numpy().reshape(sigma.shape) for values in (slab.sigma, slab.colour))
    rows = []
    for i in range(len(sigma)):
        primal = max(error(found[0][i], truth.colour[i]), error(found[1][i], truth.opacity[i]))
        if truth.opacity[i] > 1e-5:
            primal = max(primal, error(found[2][i], truth.depth[i]))
        rows.append(
            (
                primal,
                max(
                    error(by_sigma[i], truth.by_sigma[i], truth.terms[i]),
                    error(by_colour[i], truth.by_colour[i])),
            )
        )
    return rows


def largest(errors: list[tuple[float, float]]) -> tuple[float, float]:
    """The largest of several errors."""
    return max(primal for primal, _ in errors), max(gradient for _, gradient in errors)


def patterned(patterns: list[list[np.ndarray]]) -> np.ndarray:
    """(D·P, 8) optical depths: for each of D decades P patterns, whose eight entries are (D, 1, 1)."""
    return (
        np.concatenate([np.concatenate(pattern, 2) for pattern in patterns], 1) .reshape(-1, 8)
        .astype(np.float32))


@pytest.fixture(scope="module")
def depth_errors() -> list[tuple[float, float]]:
    """Six rays for each decade: of eight segments some have that optical depth, the others 0, 1e-3, 1 or its
    inverse."""
    x = 10.0 ** np.array(DECADES)[:, None, None]
    ones = np.ones_like(x)
    tau = patterned(
        [
            [x] * 8, [x, 0 * x, x, 1e-3 * ones, x, ones, x, 0 * x], [ones, x] * 4,
            [1e-3 * ones] * 4 + [x] * 4, [x, 1 / x] * 4, [0 * x] * 7 + [x]]
    )
    return errors_of(tau, np.tile(np.linspace(0.1, 0.9, 8), (len(tau), 1)).astype(np.float32), 8.0)


@case(
    "optical depth of a segment: colour, opacity, depth; thick before, between and behind thin ones",
    "1e-38 to 1e38", relative_to=TERMS)
@pytest.mark.parametrize("index", range(len(DECADES)), ids=map("1e{}".format, DECADES))
def test_optical_depth(check: Check, depth_errors: list[tuple[float, float]], index: int) -> None:
    check(*largest(depth_errors[6 * index : 6 * index + 6]))


@case("segments of optical depth 1 of any length", "1e-6 to 1e6 m", relative_to=TERMS)
@pytest.mark.parametrize("decade", range(-6, 7), ids="1e{} m".format)
def test_segment_length(check: Check, decade: int) -> None:
    """Only σδ matters: no length or density is too large or too small by itself."""
    length = float(np.float32(10.0**decade))
    check(
        *largest(
            errors_of(
                np.full((3, 4), 4 / length).astype(np.float32) * np.array([[0.1], [1], [3]], np.float32),
                length=length)
        )
    )


@case("number of samples per ray", "1 to 100,000", relative_to=TERMS)
@pytest.mark.parametrize("samples", [1, 10, 64, 100, 257, 1000, 9973, 10_000, 100_000], ids=str)
def test_samples_a_ray(check: Check, samples: int) -> None:
    """Three rays of optical depth 0.01, 3 and 30 through a density that varies in waves."""
    wave = 1 + np.sin(0.3 + 9 * (np.arange(samples) + 0.5) / samples)
    check(*largest(errors_of((np.array([[0.01], [3.0], [30.0]]) * wave).astype(np.float32))))


@case(
    "density exactly zero and just above it, alone and among others", "0 and 1e-45 to 1e-30 per metre",
    relative_to=TERMS)
@pytest.mark.parametrize("density", [0.0, *decades(-45, -30)], ids="{:g}".format)
def test_density_zero(check: Check, density: float) -> None:
    """Where there is no density, the gradient is that of the first bit of it, not zero."""
    sigma = np.array([[1, 1, 1, 1], [1, 0, 1, 0], [0, 0, 0, 1]]) * density + np.array(
        [[0.0], [0.0], [2.0]]) * [1, 0, 1, 0]
    check(*largest(errors_of(sigma.astype(np.float32))))


@pytest.fixture(scope="module")
def overlap_errors() -> list[tuple[float, float]]:
    """Errors of colour and transmittance of two slabs, and of derivatives of their difference, by decade.

    Segments of the first have that optical depth or none; those of the second have the same, its inverse, 0
    or 1.
    """
    x = 10.0 ** np.array(DECADES)[:, None, None]
    ones = np.ones_like(x)
    second = patterned([[x] * 8, [ones] * 8, [0 * x] * 8, [x, 1 / x] * 4, [ones, 0 * x] * 4])
    first = np.broadcast_to(x, (len(x), 5, 8)).reshape(-1, 8) * np.tile(
        [1, 0, 1, 1, 0, 1, 0, 1], (len(second), 1))
    first = first.astype(np.float32)
    red, blue = (
        np.tile(np.linspace(*ends, 8), (len(first), 1)).astype(np.float32)
        for ends in ((0.1, 0.9), (0.7, 0.2)))
    slabs = Slab(first, red, 8.0), Slab(second, blue, 8.0)
    dr.enable_grad([slab.sigma for slab in slabs])
    seen = Transport(8)([Performer(slab) for slab in slabs], slabs[0].rays())
    dr.backward(dr.sum(seen.colour.x - seen.transmittance))
    colour, transmittance, slopes, terms = integrate_two(
        first.astype(np.float64), second.astype(np.float64), red, blue)
    found = [dr.grad(slab.sigma).numpy().reshape(first.shape) for slab in slabs]
    return [
        (
            max(
                error(seen.colour.x.numpy()[i], colour[i]),
                error(seen.transmittance.numpy()[i], transmittance[i])),
            max(
                error(ours[i], slope[i], max(term[i].max(), 1e-12))
                for ours, slope, term in zip(found, slopes, terms, strict=True)),
        )
        for i in range(len(first))
    ]


@case(
    "two fields that overlap, in ndf_path: colour, transmittance",
    "optical depths of a stratum of 1e-38 to 1e38",
    relative_to=TERMS + ", the largest of a ray, at least 1e-12")
@pytest.mark.parametrize("index", range(len(DECADES)), ids=map("1e{}".format, DECADES))
def test_overlapping_fields(check: Check, overlap_errors: list[tuple[float, float]], index: int) -> None:
    check(*largest(overlap_errors[5 * index : 5 * index + 5]))


FUNCTIONS: dict[str, tuple[Callable[[Any], Any], Callable, Callable, Callable]] = {
    # Ours, the reference, its derivative, and the arguments for positive x.
    "expm1": (expm1, np.expm1, np.exp, lambda x: np.concatenate([-x, x[x <= 80]])),
    "log1p": (log1p, np.log1p, lambda x: 1 / (1 + x), lambda x: x),
    "softplus": (softplus, lambda x: np.logaddexp(0, x), logistic, lambda x: np.concatenate([x, -x])),
}


@case("expm1, log1p and softplus", "0 and 1e-38 to 1e38, both signs where defined")
@pytest.mark.parametrize("start", [0.0, *decades(-38, 38)], ids="{:g}".format)
def test_elementary_functions(check: Check, start: float) -> None:
    """Values and derivatives over a decade; expm1 up to the end of float32."""
    x = start * np.geomspace(1, 9.7, 20)
    x = x[x < 3e38].astype(np.float32).astype(np.float64)
    errors = []
    for ours, reference, slope, arguments in FUNCTIONS.values():
        at = arguments(x)
        value = mi.Float(at)
        dr.enable_grad(value)
        result = ours(value)
        dr.backward(dr.sum(result))
        errors.append((error(result.numpy(), reference(at)), error(dr.grad(value).numpy(), slope(at))))
    check(*largest(errors))
