"""The performers of a scene, each once, and what a scene may not hold beside them."""

from __future__ import annotations

import os
from typing import Any

import mitsuba as mi

from ndf_mi.errors import InputError
from ndf_mi.render.colours import tell
from ndf_mi.render.transport import Performer


def performers(scene: mi.Scene, who: str) -> list[Performer]:
    """The fields of a scene's ``ndf`` media, with the parameters that they have now, in the order of the scene's shapes.

    Several media of one run, frame, scale and offset are one performer, seen once, and the first speaks for all; so are the layers between
    nested shells, each of which names the medium that it is part of as its `field`.

    Args:
        who: the integrator, for messages.

    Raises:
        InputError: the scene holds another medium, or the BSDF of a shape around an ``ndf`` medium lets no light in.
    """
    found: dict[Any, Any] = {}
    for shape in scene.shapes():
        for medium in (shape.interior_medium(), shape.exterior_medium()):
            if medium is not None:
                field = _field(medium, f"{who}: {_name(shape)}")
                found.setdefault((os.path.realpath(field.run.path), field.frame, field.scale, tuple(field.offset.tolist())), field)
        if shape.interior_medium() is not None:
            _check_bsdf(shape, who)
    for sensor in scene.sensors():
        if sensor.get_medium() is not None:
            _field(sensor.get_medium(), f"{who}: the sensor's medium")
    for field in found.values():
        tell(field.run, scattering=False)
    return [Performer(field.posed(), float(field.scale)) for field in found.values()]


def lets_light_in(bsdf: mi.BSDF) -> bool:
    """Whether light can get through a surface, straight on, refracted or scattered."""
    flags = int(bsdf.flags())
    through = (mi.BSDFFlags.Null, mi.BSDFFlags.DeltaTransmission, mi.BSDFFlags.GlossyTransmission, mi.BSDFFlags.DiffuseTransmission)
    return any(flags & int(flag) for flag in through)


def _field(medium: Any, where: str) -> Any:
    """The ``ndf`` medium that a medium is, or is part of."""
    field = getattr(medium, "field", medium)
    if not hasattr(field, "posed"):
        raise InputError(where, f"a medium of the class {medium.class_name()}", "no media but `ndf`",
                         "Only performers are integrated along rays: take the medium away, or render with `volpath`.")
    return field


def _check_bsdf(shape: mi.Shape, who: str) -> None:
    if not lets_light_in(shape.bsdf()):
        raise InputError(f"{who}: {_name(shape)}", f"the BSDF {shape.bsdf().class_name()} around an `ndf` medium",
                         'one that lets light in: `<bsdf type="null"/>`')


def _name(shape: mi.Shape) -> str:
    return f"the shape {shape.id()!r}" if shape.id() else f"a shape of the class {shape.class_name()}"
