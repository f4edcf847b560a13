"""Path replay backpropagation along given rays, with a background behind the scene instead of its lights."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


class Replay:
    """Paths along rays, traced once for their radiance and again for gradients.

    Camera rays that leave the scene without an interaction see `background` and no emitter. Gradients are
    exact, too: the second pass receives the background as the radiance of such paths, so that every weight
    along the way gets its share.

    Args:
        scene: its parameters receive the gradients.
        integrator: one of Mitsuba's that replay paths, made with `hide_emitters` and used for no other scene.
        background: linear radiance.
    """

    def __init__(self, scene: mi.Scene, integrator: Any, background: mi.Color3f) -> None:
        self._scene = scene
        self._integrator = integrator
        self._background = mi.Color3f(background)
        dr.make_opaque(self._background)
        self._sampler = mi.load_dict({"type": "independent"})

    def radiance(self, ray: mi.Ray3f, seed: int) -> mi.Color3f:
        """(N) linear radiance, detached, of one path along each of N rays; independent for different
        seeds."""
        with dr.suspend_grad():
            found, valid, *_ = self._integrator.sample(
                mode=dr.ADMode.Primal,
                scene=self._scene,
                sampler=self._seeded(ray, seed),
                ray=ray,
                depth=mi.UInt32(0),
                δL=None,
                state_in=None,
                active=mi.Bool(True),
            )
            radiance = dr.select(valid, mi.Color3f(found), self._background)
            dr.eval(radiance)
        return radiance

    def backward(self, ray: mi.Ray3f, seed: int, radiance: mi.Color3f, adjoint: mi.Color3f) -> None:
        """Adds Σ adjoint · ∂radiance to the gradients of the scene's parameters.

        Args:
            ray, seed: as for `radiance`.
            radiance: the result of :meth:`radiance` for them.
            adjoint: (N), detached.
        """
        with dr.suspend_grad():
            self._integrator.sample(
                mode=dr.ADMode.Backward,
                scene=self._scene,
                sampler=self._seeded(ray, seed),
                ray=ray,
                depth=mi.UInt32(0),
                δL=mi.Spectrum(adjoint),
                state_in=mi.Spectrum(radiance),
                active=mi.Bool(True),
            )

    def _seeded(self, ray: mi.Ray3f, seed: int) -> mi.Sampler:
        self._sampler.seed(dr.opaque(mi.UInt32, seed), dr.width(ray.d))
        return self._sampler


def repeated(ray: mi.Ray3f, count: int) -> mi.Ray3f:
    """Each of N rays `count` times, its copies adjacent."""
    parent = dr.arange(mi.UInt32, max(dr.width(ray.o), dr.width(ray.d)) * count) // count
    return mi.Ray3f(dr.gather(mi.Point3f, ray.o, parent), dr.gather(mi.Vector3f, ray.d, parent))
