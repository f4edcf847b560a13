"""Path replay backpropagation along given rays, with a background behind the scene instead of its lights."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi


class Replay:
    """Paths along rays, traced once for their radiance and again for gradients.

    Camera rays that leave the scene without an interaction see `background` and no emitter. The second pass
    receives it as the radiance of such paths, so that every weight along the way gets its gradient.

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
            found, valid, *_ = self._sample(dr.ADMode.Primal, ray, seed, None, None)
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
            self._sample(dr.ADMode.Backward, ray, seed, mi.Spectrum(adjoint), mi.Spectrum(radiance))

    def _sample(self, mode: dr.ADMode, ray: mi.Ray3f, seed: int, δL: Any, state_in: Any) -> Any:
        self._sampler.seed(dr.opaque(mi.UInt32, seed), dr.width(ray.d))
        return self._integrator.sample(
            mode=mode, scene=self._scene, sampler=self._sampler, ray=ray, depth=mi.UInt32(0), δL=δL,
            state_in=state_in, active=mi.Bool(True))


def repeated(ray: mi.Ray3f, count: int) -> mi.Ray3f:
    """Each of N rays `count` times, its copies adjacent."""
    parent = dr.arange(mi.UInt32, max(dr.width(ray.o), dr.width(ray.d)) * count) // count
    return mi.Ray3f(dr.gather(mi.Point3f, ray.o, parent), dr.gather(mi.Vector3f, ray.d, parent))
