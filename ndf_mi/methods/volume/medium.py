"""A trained volume in a Mitsuba scene: a medium that `ndf_path` and `ndf_quadrature` show, in a box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.render.ray_samples import VolumeField


@dataclass(frozen=True)
class Source:
    """What a medium says of where it comes from, as a `Run` does.

    Attributes:
        path: names it in messages; media of the same path and frame are the same performer.
        colours: that they are light, not albedos.
    """

    path: Path
    colours: str = "light"


def boxed(volume: VolumeField, name: str, frame: int) -> dict[str, Any]:
    """A shape for `mi.load_dict`: the volume's box with nothing on its faces and the volume inside.

    Args:
        volume: at its pose.
        name: tells volumes apart.
        frame: of the pose.
    """
    low, high = (np.array(corner, np.float64).ravel() for corner in (volume.bbox.min, volume.bbox.max))
    place = mi.ScalarTransform4f().translate(0.5 * (low + high)).scale(0.5 * (high - low))
    medium = _medium(str(mi.variant()))(volume, Source(Path(name)), frame)
    return {"type": "cube", "to_world": place, "bsdf": {"type": "null"}, "interior": medium}


@cache
def _medium(variant: str) -> Any:
    """The class of media, which can only be defined once a variant is set."""

    class VolumeMedium(mi.Medium):
        """A volume as a `FieldMedium`: it is its own `neural_field`."""

        outermost = True
        scale = 1.0

        def __init__(self, volume: VolumeField, run: Source, frame: int) -> None:
            super().__init__(mi.Properties("volume"))
            self.m_is_homogeneous = False
            self.m_has_spectral_extinction = False
            self.run, self.frame = run, frame
            self.offset = np.zeros(3, np.float32)
            self._volume = volume

        @property
        def neural_field(self) -> VolumeMedium:
            return self

        def posed(self) -> VolumeField:
            return self._volume

        def intersect_aabb(self, ray: mi.Ray3f) -> tuple[mi.Bool, mi.Float, mi.Float]:
            return self._volume.bbox.ray_intersect(ray)

        def get_majorant(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> Any:
            raise _scattered(self.run)

        def get_scattering_coefficients(self, mei: mi.MediumInteraction3f, active: mi.Bool = True) -> Any:
            raise _scattered(self.run)

        def to_string(self) -> str:
            return f"VolumeMedium[\n  volume = {self.run.path},\n  frame = {self.frame}\n]"

    return VolumeMedium


def _scattered(run: Source) -> InputError:
    return InputError(str(run.path), "a volume whose colours are light, to be scattered",
                      "an integrator that shows it by emission and absorption",
                      "Use `ndf_path` or `ndf_quadrature`.")
