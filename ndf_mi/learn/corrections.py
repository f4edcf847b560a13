"""The corrections of a capture's fit and colours that are trained with the field."""

from __future__ import annotations

from dataclasses import dataclass, fields

import drjit as dr
import mitsuba as mi
import numpy as np


@dataclass(frozen=True)
class Corrections:
    """Corrections in standard deviations of their priors, one flat array a group; zeros correct nothing. None
    where a group is not trained.

    Attributes:
        pose: of :class:`ndf_mi.learn.pose_corrections.PoseCorrections`, a row a training frame.
        shape: of the same class, one number a shape coefficient.
        cameras: of :class:`ndf_mi.learn.camera_corrections.CameraCorrections`, a row a training camera.
        colours: of :class:`ndf_mi.learn.camera_colours.CameraColours`, a row a training camera.
    """

    pose: mi.Float | None = None
    shape: mi.Float | None = None
    cameras: mi.Float | None = None
    colours: mi.Float | None = None

    def groups(self) -> dict[str, mi.Float]:
        """The groups that are trained, by name."""
        return {name: value for name in GROUPS if (value := getattr(self, name)) is not None}

    def detached(self) -> Corrections:
        """The same values without gradients."""
        return Corrections(**{name: dr.detach(value) for name, value in self.groups().items()})


GROUPS = tuple(field.name for field in fields(Corrections))
"""Names of all groups."""

NONE = Corrections()
"""Nothing is corrected."""


def rows(values: mi.Float, columns: int) -> np.ndarray:
    """(N, columns) float64 of a flat array."""
    return np.asarray(dr.detach(values)).astype(np.float64).reshape(-1, columns)
