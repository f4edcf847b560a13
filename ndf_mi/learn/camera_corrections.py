"""Corrections of cameras: a rotation about the centre of projection, a shift of the centre and a focal
length."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.skinning import rodrigues
from ndf_mi.capture.camera import Camera
from ndf_mi.learn.corrections import rows
from ndf_mi.numerics import expm1

ROTATION = math.radians(0.5)
"""Standard deviation of each component of the rotation, radians: some pixels of an image of 1,000. A
calibration that is worse than this is not a matter of refinement."""

TRANSLATION = 0.01
"""Standard deviation of each component of the centre's shift, metres."""

FOCAL = 0.01
"""Standard deviation of the logarithm of the factor on the focal length."""

COLUMNS = 7
"""Numbers a camera: rotation, shift, focal length."""

DEVIATIONS = np.array([ROTATION] * 3 + [TRANSLATION] * 3 + [FOCAL])


class CameraCorrections:
    """Turns rays of the calibrated cameras into those of the corrected ones.

    With the rotation vector ω and the shift τ, both in world axes, and the logarithm f of the factor on the
    focal length, a ray from o along d, of a camera that looks along a, becomes

        o' = o + τ,    d' ∝ exp([ω]×) (a (a·d) + e^(−f) (d − a (a·d)))

    Args:
        cameras: the training cameras, in the order of `Batch.camera`.
    """

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self.names = tuple(camera.name for camera in cameras)
        axes = np.stack([-np.asarray(camera.transform)[:3, 2] for camera in cameras])
        self._axes = mi.Float(np.ascontiguousarray(axes, np.float32).ravel())
        self._deviations = mi.Float(np.tile(DEVIATIONS, len(cameras)).astype(np.float32))

    @property
    def count(self) -> int:
        """How many numbers the corrections have."""
        return COLUMNS * len(self.names)

    def rays(self, corrections: mi.Float, camera: mi.UInt32, ray: mi.Ray3f) -> mi.Ray3f:
        """The corrected rays, attached to the corrections.

        Args:
            corrections: as `Corrections.cameras`.
            camera: the index of each ray's camera.
            ray: unit directions.
        """
        values = corrections * self._deviations
        turn, shift = (mi.Vector3f(*[dr.gather(mi.Float, values, camera * COLUMNS + k) for k in columns])
                       for columns in ((0, 1, 2), (3, 4, 5)))
        focal = dr.gather(mi.Float, values, camera * COLUMNS + 6)
        axis = dr.gather(mi.Vector3f, self._axes, camera)
        across = ray.d - dr.dot(ray.d, axis) * axis
        return mi.Ray3f(ray.o + shift, rodrigues(turn) @ dr.normalize(ray.d + expm1(-focal) * across))

    def tensors(self, corrections: mi.Float) -> dict[str, np.ndarray]:
        """The corrections in radians, metres and as logarithms: `camera_rotation` (C, 3),
        `camera_translation` (C, 3) and `camera_focal` (C,), float32."""
        values = (rows(corrections, COLUMNS) * DEVIATIONS).astype(np.float32)
        return {"camera_rotation": values[:, :3].copy(), "camera_translation": values[:, 3:6].copy(),
                "camera_focal": values[:, 6].copy()}


def corrected(camera: Camera, rotation: np.ndarray, translation: np.ndarray, focal: float) -> Camera:
    """A camera with one row of :meth:`CameraCorrections.tensors` applied."""
    transform = np.array(camera.transform, dtype=np.float64)
    transform[:3, :3] = Rotation.from_rotvec(np.asarray(rotation, np.float64)).as_matrix() @ transform[:3, :3]
    transform[:3, 3] += translation
    factor = math.exp(focal)
    return dataclasses.replace(camera, transform=transform, fl_x=camera.fl_x * factor,
                               fl_y=camera.fl_y * factor)
