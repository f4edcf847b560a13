"""A field of known density: a ridge over the signed distance l that falls exponentially on both sides."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mitsuba as mi
import numpy as np

Density = Callable[[np.ndarray], np.ndarray]


def make_ridge(
    make_run: Callable[..., Any],
    name: str = "ridge",
    peak: float = 1.0,
    slope: float = 60.0,
    low: float = 0.01,
    high: float = 0.02,
    srgb: tuple[float, float, float] = (1e-6,) * 3,
    **changes: Any,
) -> tuple[Any, Density]:
    """A saved run around the ball, and its density in 1/m as a float64 function of l in metres.

    σ = limit·(1 − exp(−gain·softplus(z) / limit))·fade, z = peak − slope·(max(l* − high*, 0) + max(low* − l*,
    0)), where * maps −`band_inside` … `band` to 0 … 1.
    """
    run = make_run(
        name,
        **{
            "encoding": "frequency",
            "octaves": 0,
            "deformation_layers": (),
            "density_bias": 0.0,
            "density_gain": 60.0,
            "density_limit": 200.0,
            **changes,
        },
    )
    field, preset = run.model.field, run.model.field.preset
    weights = run.parameters.weights.numpy()

    def unit(l):
        return (l + preset.band_inside) / (preset.band + preset.band_inside)

    def layer(name):
        at = field.layers[name]
        return at.offset, at.inputs + at.pose, at.outputs

    start, columns, outputs = layer("density0")
    weights[start : start + field.layers["density0"].size] = 0
    weights[start + 2], weights[start + columns + 2] = 1, -1
    weights[start + outputs * columns], weights[start + outputs * columns + 1] = -unit(high), unit(low)
    start, columns, outputs = layer("density_out")
    weights[start : start + columns] = 0
    weights[start], weights[start + 1], weights[start + outputs * columns] = -slope, -slope, peak
    start, columns, outputs = layer("colour_out")
    for row, value in enumerate(srgb):
        weights[start + row * columns : start + (row + 1) * columns] = 0
        weights[start + outputs * columns + row] = np.log(value / (1 - value))
    run.parameters = run.parameters.replace(weights=mi.Float(weights))
    run.save()

    def density(l: np.ndarray) -> np.ndarray:
        l = np.asarray(l, np.float64)
        z = peak - slope * (np.maximum(unit(l) - unit(high), 0) + np.maximum(unit(low) - unit(l), 0))
        sigma = preset.density_limit * -np.expm1(
            -preset.density_gain * np.logaddexp(0, z) / preset.density_limit
        )
        if preset.band_fade > 0:
            for depth in ((preset.band - l) / preset.band, (preset.band_inside + l) / preset.band_inside):
                s = np.clip(depth / preset.band_fade, 0, 1)
                sigma = sigma * s * s * (3 - 2 * s)
        return np.where((l <= preset.band) & (l >= -preset.band_inside), sigma, 0)

    return run, density


def peak_of(run: Any) -> int:
    """Where among the weights `peak` is."""
    at = run.model.field.layers["density_out"]
    return int(at.offset + at.outputs * (at.inputs + at.pose))
