"""Maps of colour by camera: what exposure, white balance and veiling light do to the performer's radiance."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.learn.corrections import rows

MATRIX = 0.1
"""Standard deviation of each entry of A − 1: a seventh of a stop between cameras that were set alike."""

OFFSET = 0.02
"""Standard deviation of each entry of b, linear radiance, where white is 1."""

COLUMNS = 12
"""Numbers a camera: A row by row, then b."""

_DEVIATIONS = np.array([MATRIX] * 9 + [OFFSET] * 3)
_IDENTITY = np.append(np.eye(3).ravel(), [0.0] * 3)


class CameraColours:
    """An affine map a camera of the performer's radiance, in linear light and before compositing:

        L' = A L + b·opacity

    L is premultiplied by the opacity. The background is the capture's own colour and stays. The maps' mean
    over the cameras is the identity, whatever the corrections: the field keeps the mean of the cameras.

    Args:
        cameras: how many training cameras there are.
    """

    def __init__(self, cameras: int) -> None:
        self._cameras = cameras
        self._deviations = mi.Float(np.tile(_DEVIATIONS, cameras).astype(np.float32))
        self._identity = mi.Float(np.tile(_IDENTITY, cameras).astype(np.float32))

    @property
    def count(self) -> int:
        """How many numbers the corrections have."""
        return COLUMNS * self._cameras

    def maps(self, corrections: mi.Float) -> mi.Float:
        """A and b of all cameras, flat, `COLUMNS` numbers a camera; attached."""
        lane = dr.arange(mi.UInt32, self.count)
        mean = dr.zeros(mi.Float, COLUMNS)
        dr.scatter_add(mean, corrections / self._cameras, lane % COLUMNS)
        centred = corrections - dr.gather(mi.Float, mean, lane % COLUMNS)
        return self._identity + self._deviations * centred

    def seen(self, corrections: mi.Float, camera: mi.UInt32, colour: mi.Color3f, opacity: mi.Float
             ) -> mi.Color3f:
        """The premultiplied radiance that each ray's camera sees of a linear, premultiplied one; attached."""
        return applied(self.maps(corrections), camera, colour, opacity)

    def unseen(self, corrections: mi.Float, camera: np.ndarray, target: np.ndarray, mask: np.ndarray,
               background: np.ndarray) -> np.ndarray:
        """Targets without what their cameras do to colour: the inverse of :meth:`seen` on composited pixels.

        Args:
            camera: (R,) indices.
            target: (3, R) sRGB in [0, 1].
            mask: (R,) the pixels' opacity.
            background: (3,) sRGB.

        Returns:
            (3, R) float32 sRGB in [0, 1].
        """
        maps = rows(self.maps(corrections), COLUMNS)[camera]
        behind = (1 - mask)[:, None] * srgb_to_linear(background.astype(np.float64))
        own = srgb_to_linear(target.T.astype(np.float64)) - behind - mask[:, None] * maps[:, 9:]
        plain = np.linalg.solve(maps[:, :9].reshape(-1, 3, 3), own[..., None])[..., 0] + behind
        return linear_to_srgb(np.clip(plain, 0, 1)).T.astype(np.float32)

    def tensors(self, corrections: mi.Float) -> dict[str, np.ndarray]:
        """`colour_matrix` (C, 3, 3) and `colour_offset` (C, 3), float32."""
        maps = rows(self.maps(corrections), COLUMNS).astype(np.float32)
        return {"colour_matrix": maps[:, :9].reshape(-1, 3, 3).copy(), "colour_offset": maps[:, 9:].copy()}


def applied(maps: mi.Float, camera: mi.UInt32, colour: mi.Color3f, opacity: mi.Float) -> mi.Color3f:
    """L' = A L + b·opacity with each ray's row of `maps`."""
    entry = [dr.gather(mi.Float, maps, camera * COLUMNS + k) for k in range(COLUMNS)]
    return mi.Color3f(*[
        entry[3 * i] * colour[0] + entry[3 * i + 1] * colour[1] + entry[3 * i + 2] * colour[2]
        + entry[9 + i] * opacity for i in range(3)])
