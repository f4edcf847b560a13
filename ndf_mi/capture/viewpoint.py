"""A camera that frames a posed body, for pictures without the cameras of a capture."""

from __future__ import annotations

import math

import numpy as np

from ndf_mi.capture.camera import Camera, look_at

_FIELD_OF_VIEW = math.radians(35.0)
_FILL = 0.8


def framing(vertices: np.ndarray, w: int, h: int, azimuth: float = 0.0, elevation: float = 5.0) -> Camera:
    """A pinhole camera aimed at the middle of a body, which fills most of the image.

    Args:
        vertices: (V, 3) posed body in metres, y up.
        w, h: image size in pixels.
        azimuth: degrees around the vertical axis, anticlockwise seen from above; 0 looks along −z.
        elevation: degrees above the horizon, in (−90, 90).
    """
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    centre = 0.5 * (low + high)
    radius = 0.5 * float(np.linalg.norm(high - low))
    focal = 0.5 * min(w, h) / math.tan(0.5 * _FIELD_OF_VIEW)
    distance = radius / (_FILL * math.sin(0.5 * _FIELD_OF_VIEW))
    a, e = math.radians(azimuth), math.radians(elevation)
    back = np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
    transform = look_at(centre + distance * back, centre)
    return Camera(f"azimuth{azimuth:g}", w, h, focal, focal, w / 2, h / 2, transform)
