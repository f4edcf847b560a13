"""The performers of a scene, each once, and what a scene may not hold beside them."""

from __future__ import annotations

import os
from typing import Any

import mitsuba as mi

from ndf_mi.errors import InputError
from ndf_mi.render.transport import Performer


def performers(scene: mi.Scene, who: str) -> list[Performer]:
    """The fields of a scene's ``ndf`` media, with the parameters that they have now, in the order of the scene's shapes.

    Several media of one run, frame and scale are one performer, seen once: nested shells each hold their own. The first speaks for all.

    Args:
        who: the integrator, for messages.

    Raises:
        InputError: the scene holds another medium, or the BSDF of a shape around an ``ndf`` medium lets no light in.
    """
    found: dict[Any, Any] = {}
    for shape in scene.shapes():
        inside, outside = shape.interior_medium(), shape.exterior_medium()
        for medium in (inside, outside):
            if medium is None:
                continue
            if not hasattr(medium, "posed"):
                raise InputError(f"{who}: {_name(shape)}", f"a medium of the class {medium.class_name()}", "no media but `ndf`",
                                 "Only performers are integrated along rays: take the medium away, or render with `volpath`.")
            found.setdefault(_identity(medium), medium)
        if inside is not None:
            _check_bsdf(shape, who)
    for sensor in scene.sensors():
        medium = sensor.get_medium()
        if medium is not None and not hasattr(medium, "posed"):
            raise InputError(f"{who}: the sensor's medium", f"one of the class {medium.class_name()}", "no media but `ndf`")
    return [Performer(medium.posed(), float(medium.scale)) for medium in found.values()]


def _identity(medium: Any) -> tuple[Any, ...]:
    """What is the same in all the media of one performer."""
    return os.path.realpath(medium.run.path), medium.frame, medium.scale


def _check_bsdf(shape: mi.Shape, who: str) -> None:
    flags = int(shape.bsdf().flags())
    through = (mi.BSDFFlags.Null, mi.BSDFFlags.DeltaTransmission, mi.BSDFFlags.GlossyTransmission, mi.BSDFFlags.DiffuseTransmission)
    if not any(flags & int(flag) for flag in through):
        raise InputError(f"{who}: {_name(shape)}", f"the BSDF {shape.bsdf().class_name()} around an `ndf` medium",
                         'one that lets light in: `<bsdf type="null"/>`')


def _name(shape: mi.Shape) -> str:
    return f"the shape {shape.id()!r}" if shape.id() else f"a shape of the class {shape.class_name()}"
