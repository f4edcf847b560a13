"""The performers of a scene: how their media are recognised, and what a scene may hold."""

from __future__ import annotations

import os
from functools import cache
from typing import Any, Protocol, runtime_checkable

import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.model import PosedModel
from ndf_mi.render.transport import Performer
from ndf_mi.run import Run

_TAKEN_FOR_ALBEDO = (
    "its colours hold the light of its capture, and the scene's lights are added to it. Use `ndf_path` or "
    "`ndf_quadrature`, or train with --integrator prbvolpath"
)
_TAKEN_FOR_LIGHT = (
    "its colours are albedos, trained through scattering, and are shown as if they were light. Use "
    "`volpath` and lights, or `ndf-mi relight`"
)


class NeuralField(Protocol):
    """A medium that holds a neural field around a body in one pose.

    Attributes:
        run, frame: where the field and the pose come from.
        offset: (3,) float32, metres; where the performer stands relative to the run.
        scale: factor on the density.
        vertices: flat (3·V) posed positions in metres, `offset` included.
    """

    run: Run
    frame: int
    offset: np.ndarray
    scale: float
    vertices: mi.Float

    def posed(self) -> PosedModel:
        """The field with the medium's present parameters; gradients flow to them."""
        ...

    def nest(self, layers: int, cell: float) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[mi.Medium]]:
        """Nested shells around the field with its present parameters, and the medium between each and the
        next.

        Args:
            layers: largest number of shells.
            cell: spacing in metres of the grid that they are cut from.

        Returns:
            the shells from the outermost on, as vertices and faces, and as many media. These share the
            field's parameters, which the first exposes, and its phase function; their majorants follow
            changes of the parameters.
        """
        ...


@runtime_checkable
class FieldMedium(Protocol):
    """A medium of a neural field or a layer of one, as integrators and checks recognise it."""

    @property
    def neural_field(self) -> NeuralField:
        """The medium that holds the field; a layer's is the medium that it is part of."""
        ...

    @property
    def outermost(self) -> bool:
        """Whether the medium's shape bounds the whole field; false for inner layers."""
        ...


def performers(scene: mi.Scene, integrator: str) -> list[Performer]:
    """The fields of a scene's ``ndf`` media with their present parameters, in the order of the scene's
    shapes.

    Media of the same run, frame, scale and offset are one performer, and the first speaks for all. Logs a
    warning for a run whose colours are albedos, once a process.

    Args:
        integrator: the plugin's name, for messages.

    Raises:
        InputError: the scene holds another medium, or the BSDF of a shape around an ``ndf`` medium lets no
            light in.
    """
    found: dict[Any, NeuralField] = {}
    for shape in scene.shapes():
        for medium in (shape.interior_medium(), shape.exterior_medium()):
            if medium is not None:
                field = _expect_field(medium, f"{integrator}: {_name(shape)}")
                path = os.path.realpath(field.run.path)
                found.setdefault((path, field.frame, field.scale, *field.offset.tolist()), field)
        if shape.interior_medium() is not None and not lets_light_in(shape.bsdf()):
            bsdf = f"the BSDF {shape.bsdf().class_name()} around an `ndf` medium"
            expected = 'one that lets light in: `<bsdf type="null"/>`'
            raise InputError(f"{integrator}: {_name(shape)}", bsdf, expected)
    for sensor in scene.sensors():
        if sensor.get_medium() is not None:
            _expect_field(sensor.get_medium(), f"{integrator}: the sensor's medium")
    return [emitting(field) for field in found.values()]


def emitting(field: NeuralField) -> Performer:
    """A field to be shown by emission and absorption; logs a warning where its colours are albedos, once a
    run and process."""
    reason = misread(field.run, scattering=False)
    if reason is not None:
        _warn(os.path.realpath(field.run.path), f"{field.run.path}: {reason}.")
    return Performer(field.posed(), field.scale)


def misread(run: Run, scattering: bool) -> str | None:
    """Why a run's colours should not be shown as albedos, if `scattering`, or as light; None where they can
    be, or where the run does not record how it was trained."""
    if run.colours == ("light" if scattering else "albedo"):
        return _TAKEN_FOR_ALBEDO if scattering else _TAKEN_FOR_LIGHT
    return None


@cache
def _warn(run: str, text: str) -> None:
    mi.Log(mi.LogLevel.Warn, text)


def lets_light_in(bsdf: mi.BSDF) -> bool:
    """Whether light can get through a surface, straight on, refracted or scattered."""
    flags = int(bsdf.flags())
    through = (mi.BSDFFlags.Null, mi.BSDFFlags.DeltaTransmission, mi.BSDFFlags.GlossyTransmission,
               mi.BSDFFlags.DiffuseTransmission)
    return any(flags & int(flag) for flag in through)


def _expect_field(medium: mi.Medium, where: str) -> NeuralField:
    if not isinstance(medium, FieldMedium):
        repair = "Only performers are integrated along rays: remove the medium, or render with `volpath`."
        found = f"a medium of the class {medium.class_name()}"
        raise InputError(where, found, "no media but `ndf`", repair)
    return medium.neural_field


def _name(shape: mi.Shape) -> str:
    return f"the shape {shape.id()!r}" if shape.id() else f"a shape of the class {shape.class_name()}"
