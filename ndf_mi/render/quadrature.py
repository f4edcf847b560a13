"""The paper's rendering equation: emission and absorption along a ray, by quadrature.

    L = Σ_i T_i (1 − exp(−σ_i δ_i)) c_i,    T_i = exp(−Σ_{j<i} σ_j δ_j)

Only samples that can lie in the band are projected, and only those that do lie in it reach a network.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import drjit as dr
import mitsuba as mi

from ndf_mi.field.sample import FieldSample
from ndf_mi.numerics import expm1
from ndf_mi.render.sampling import Compaction, box_interval, stratified


class VolumeField(Protocol):
    """What can be rendered: something in a box that knows cheaply where it is empty, and what it is elsewhere."""

    bbox: mi.BoundingBox3f

    strata: int
    """Factor on the candidate samples a ray."""

    def near(self, x: mi.Point3f) -> mi.Bool:
        """False only where the field is empty for certain."""
        ...

    def locate(self, x: mi.Point3f, active: mi.Bool) -> tuple[Any, mi.Bool]:
        """Detached search: a handle of each point (an array to be gathered from), and whether the field is defined there."""
        ...

    def evaluate(self, x: mi.Point3f, d: mi.Vector3f, handle: Any, active: mi.Bool) -> FieldSample:
        """The field at located points; inactive lanes must be finite and are ignored."""
        ...


@dataclass
class Workspace:
    """Sizes that persist from call to call, so that kernels are compiled once: one for each kind of call (training, tiles)."""

    near: Compaction = field(default_factory=Compaction)
    inside: Compaction = field(default_factory=Compaction)


@dataclass
class Radiance:
    """What N rays see of a field.

    Attributes:
        colour: L, linear, premultiplied; composite a background B as L + (1 − opacity)·B.
        opacity: 1 − transmittance over the whole ray.
        depth: expected distance along the ray where the field is met, in scene units; 0 where opacity is 0.
        u, normal: expected (u, v, l) and normal there; only if asked for, else None.
        samples: the field at the samples that reached a network, `inside` which of those lanes are real, for regularisers.
        evaluated: how many samples reached a network.
    """

    colour: mi.Color3f
    opacity: mi.Float
    depth: mi.Float
    u: mi.Point3f | None
    normal: mi.Normal3f | None
    samples: FieldSample
    inside: mi.Bool
    evaluated: int


def quadrature(
    volume: VolumeField,
    ray: mi.Ray3f,
    samples: int,
    *,
    jitter: mi.Float | None = None,
    window: tuple[int, int] | None = None,
    scale: float = 1.0,
    workspace: Workspace | None = None,
    geometry: bool = False,
) -> Radiance:
    """Renders `volume` along N rays (directions of unit length) with `samples` candidate samples each.

    Differentiable in whatever `volume.evaluate` is differentiable in, and in the rays; where samples are placed, and which of
    them reach the network, is detached.

    Args:
        jitter: N·samples·strata numbers in [0, 1) for stratified sampling; None for the strata's middles. Not with `window`.
        window: first of the samples and how many of them to look at: the part of the ray that those strata cover. None for all.
        scale: factor on the density.
        workspace: keeps array sizes steady over calls; a fresh one is made where None.
        geometry: also return (u, v, l) and normals.
    """
    workspace = workspace or Workspace()
    rays = max(dr.width(ray.o), dr.width(ray.d))
    ray = mi.Ray3f(ray)
    ray.o = ray.o + dr.zeros(mi.Vector3f, rays)
    ray.d = ray.d + dr.zeros(mi.Vector3f, rays)
    first, count = window or (0, samples)
    part = first * volume.strata, count * volume.strata, samples * volume.strata
    samples = part[1]
    lanes = rays * samples

    with dr.suspend_grad():
        hit, near, far = box_interval(volume.bbox, ray)
        if window is not None:
            step = (far - near) / part[2]
            near = dr.fma(step, dr.opaque(mi.Float, part[0]), near)
            far = dr.fma(step, part[1], near)
        t, delta = stratified(near, far, samples, jitter)
        parent = dr.arange(mi.UInt32, lanes) // samples
        x = mi.Point3f(dr.gather(mi.Point3f, ray.o, parent) + dr.gather(mi.Vector3f, ray.d, parent) * t)
        candidate = dr.gather(mi.Bool, hit, parent) & volume.near(x)
        dr.eval(candidate, t, delta)
        chosen, real, _ = workspace.near(candidate)
        parent = chosen // samples
        x = mi.Point3f(dr.gather(mi.Point3f, ray.o, parent) + dr.gather(mi.Vector3f, ray.d, parent) * dr.gather(mi.Float, t, chosen))
        handle, inside = volume.locate(x, real)
        inside &= real
        dr.eval(handle, inside)
        second, real, evaluated = workspace.inside(inside)
        index = dr.gather(mi.UInt32, chosen, second)
        handle = dr.gather(type(handle), handle, second)
        dr.eval(index, handle, real)

    parent = index // samples
    o, d = dr.gather(mi.Point3f, ray.o, parent), dr.gather(mi.Vector3f, ray.d, parent)
    sample = volume.evaluate(mi.Point3f(o + d * dr.gather(mi.Float, t, index)), d, handle, real)

    def spread(value: mi.Float) -> mi.Float:
        """Back to one lane a candidate; zero where nothing was evaluated."""
        return _scatter(value, index, real, lanes)

    sigma = sample.sigma if sample.weight is None else sample.sigma * sample.weight
    if scale != 1.0:
        sigma = sigma * dr.opaque(mi.Float, scale)
    tau = spread(sigma) * delta
    weight = dr.exp(-dr.block_prefix_sum(tau, samples, exclusive=True)) * -expm1(-tau)

    def expect(value: mi.Float) -> mi.Float:
        return dr.block_sum(weight * spread(value), samples)

    opacity = -expm1(-dr.block_sum(tau, samples))
    norm = dr.rcp(dr.maximum(opacity, 1e-6))
    return Radiance(
        colour=mi.Color3f(*[expect(c) for c in sample.colour]),
        opacity=opacity,
        depth=dr.block_sum(weight * t, samples) * norm,
        u=mi.Point3f(*[expect(c) * norm for c in sample.u]) if geometry else None,
        normal=mi.Normal3f(*[expect(c) * norm for c in sample.normal]) if geometry else None,
        samples=sample,
        inside=real,
        evaluated=evaluated,
    )


def _scatter(value: mi.Float, index: mi.UInt32, active: mi.Bool, width: int) -> mi.Float:
    target = dr.zeros(mi.Float, width)
    dr.scatter(target, value, index, active, mode=dr.ReduceMode.Permute)
    return target
