"""A calibrated camera with the keys of nerfstudio's ``transforms.json``, also as a Mitsuba sensor."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

#: From OpenGL's camera axes (x right, y up, along -z) to Mitsuba's (x left, y up, along +z), and back.
_GL_FROM_MITSUBA = np.diag([-1.0, 1.0, -1.0, 1.0])

#: Largest relative difference of fl_x and fl_y for square pixels: below 1e-3 pixels in 1000.
_SQUARE = 1e-6

#: Field of view of `framing` in radians, and the part of the image that the body fills.
_FRAMED, _FILL = math.radians(35.0), 0.8


@dataclass(frozen=True)
class Camera:
    """One camera: size and intrinsics in pixels, pose in metres.

    Attributes:
        name: the name of the camera and of its folder.
        w, h: image size.
        fl_x, fl_y, cx, cy: focal lengths and principal point in pixels; (0.5, 0.5) is the centre of the top
            left pixel.
        transform: (4, 4) camera-to-world in OpenGL's axes (x right, y up, looking along -z), a rigid motion.
        distortion: k1, k2, k3, p1, p2 of OpenCV's radial and tangential model; zeros mean none.
    """

    name: str
    w: int
    h: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    transform: np.ndarray
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def is_pinhole(self) -> bool:
        """Whether the camera has square pixels and no distortion, as Mitsuba's sensor requires."""
        return not any(self.distortion) and abs(self.fl_x - self.fl_y) <= _SQUARE * self.fl_x

    @property
    def position(self) -> np.ndarray:
        """(3,) the centre of projection in world space."""
        return np.asarray(self.transform, dtype=np.float64)[:3, 3]

    def scaled(self, w: int, h: int) -> Camera:
        """The same view with another image size."""
        x, y = w / self.w, h / self.h
        return replace(self, w=w, h=h, fl_x=self.fl_x * x, fl_y=self.fl_y * y, cx=self.cx * x, cy=self.cy * y)

    def pinhole(self) -> Camera:
        """The pinhole camera at the same place: no distortion, square pixels of the mean focal length."""
        focal = self.fl_x if self.is_pinhole else 0.5 * (self.fl_x + self.fl_y)
        return replace(self, fl_x=focal, fl_y=focal, distortion=(0.0,) * 5)

    def distort(self, normalised: np.ndarray) -> np.ndarray:
        """OpenCV's distortion of (N, 2) normalised image coordinates (x right, y down, at depth 1).

        x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2x²),
        y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2y²) + 2 p2 x y.
        """
        k1, k2, k3, p1, p2 = self.distortion
        x, y = normalised[:, 0], normalised[:, 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack([x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                         y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], axis=1)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Projects (N, 3) world points to (N, 2) float64 pixel coordinates, distortion included.

        Points in or behind the camera's plane give NaN.
        """
        local = self.to_camera(points)
        depth = np.where(local[:, 2] < 0, -local[:, 2], np.nan)[:, None]
        normalised = np.concatenate([local[:, :1], -local[:, 1:2]], axis=1) / depth
        if any(self.distortion):
            normalised = self.distort(normalised)
        return normalised * [self.fl_x, self.fl_y] + [self.cx, self.cy]

    def to_camera(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points in this camera's OpenGL axes, float64; -z is the depth in metres."""
        transform = np.asarray(self.transform, dtype=np.float64)
        return (np.asarray(points, dtype=np.float64) - transform[:3, 3]) @ transform[:3, :3]

    def rays(self, pixels: mi.Point2f) -> mi.Ray3f:
        """World rays of unit direction through pixels; (0.5, 0.5) is the centre of the top left one.

        Intrinsics and pose are opaque values, so that one kernel serves all cameras. A camera with distortion
        raises ValueError: use ``pinhole()``.
        """
        if any(self.distortion):
            raise ValueError(f"camera {self.name} has distortion: use camera.pinhole()")

        def scalar(value: float) -> mi.Float:
            return dr.opaque(mi.Float, float(value))

        x = (pixels.x - scalar(self.cx)) * scalar(1 / self.fl_x)
        y = (scalar(self.cy) - pixels.y) * scalar(1 / self.fl_y)
        columns: list[Any] = [mi.Vector3f(*map(scalar, column)) for column in self.transform[:3, :4].T]
        right, up, back, origin = columns
        return mi.Ray3f(mi.Point3f(origin), dr.normalize(right * x + up * y - back))

    def sensor(self, spp: int = 1, sampler: str = "independent", rfilter: str = "box",
               crop: tuple[int, int, int, int] | None = None) -> dict[str, Any]:
        """This camera as the dictionary of a Mitsuba ``perspective`` sensor with an ``hdrfilm``.

        ``sampler`` and ``rfilter`` name Mitsuba's plugins; ``crop`` is the x, y, width and height of the part
        to render in pixels, by default the whole image. A camera with distortion or pixels that are not
        square raises ValueError: use ``pinhole()``.
        """
        if not self.is_pinhole:
            raise ValueError(f"camera {self.name} has distortion or non-square pixels: use camera.pinhole()")
        film: dict[str, Any] = {"type": "hdrfilm", "width": self.w, "height": self.h, "pixel_format": "rgba",
                                "component_format": "float32", "rfilter": {"type": rfilter}}
        if crop is not None:
            names = ("crop_offset_x", "crop_offset_y", "crop_width", "crop_height")
            film.update(zip(names, map(int, crop), strict=True))
        to_world = np.asarray(self.transform, dtype=np.float64) @ _GL_FROM_MITSUBA
        return {
            "type": "perspective",
            "fov_axis": "x",
            "fov": math.degrees(2 * math.atan(self.w / (2 * self.fl_x))),
            # Mitsuba shifts the sample's position before it maps it to the image plane, hence the sign.
            "principal_point_offset_x": 0.5 - self.cx / self.w,
            "principal_point_offset_y": 0.5 - self.cy / self.h,
            "near_clip": 1e-2,
            "far_clip": 1e4,
            "to_world": mi.ScalarTransform4f(to_world.tolist()),
            "film": film,
            "sampler": {"type": sampler, "sample_count": spp},
        }


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) camera-to-world in OpenGL's axes of a camera that looks from one point to another, y up."""
    back = position - target
    back /= np.linalg.norm(back)
    right = np.cross([0.0, 1.0, 0.0], back)
    right /= np.linalg.norm(right)
    transform = np.eye(4)
    transform[:3] = np.stack([right, np.cross(back, right), back, position], axis=1)
    return transform


def is_rotation(matrix: np.ndarray) -> bool:
    """Whether a (3, 3) matrix is a rotation, within 1e-3."""
    return np.abs(matrix @ matrix.T - np.eye(3)).max() <= 1e-3 and np.linalg.det(matrix) > 0


def framing(vertices: np.ndarray, w: int, h: int, azimuth: float = 0.0, elevation: float = 5.0) -> Camera:
    """A pinhole camera aimed at the middle of a body, which fills most of the image: for pictures without a
    capture's cameras.

    Args:
        vertices: (V, 3) posed body in metres, y up.
        w, h: image size in pixels.
        azimuth: degrees around the vertical axis, anticlockwise seen from above; 0 looks along −z.
        elevation: degrees above the horizon, in (−90, 90).
    """
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    centre = 0.5 * (low + high)
    radius = 0.5 * float(np.linalg.norm(high - low))
    focal = 0.5 * min(w, h) / math.tan(0.5 * _FRAMED)
    distance = radius / (_FILL * math.sin(0.5 * _FRAMED))
    a, e = math.radians(azimuth), math.radians(elevation)
    back = np.array([math.sin(a) * math.cos(e), math.sin(e), math.cos(a) * math.cos(e)])
    transform = look_at(centre + distance * back, centre)
    return Camera(f"azimuth{azimuth:g}", w, h, focal, focal, w / 2, h / 2, transform)


def pixel_rays(camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions, (3, N) float64, of the rays of a pinhole camera through the centres of
    ``pixels``, (N,) indices row by row; in numpy, for sampling and masks, where no kernel is needed."""
    y, x = np.divmod(pixels.astype(np.int64), camera.w)
    local = np.stack([(x + 0.5 - camera.cx) / camera.fl_x, (camera.cy - y - 0.5) / camera.fl_y,
                      -np.ones(len(pixels))])
    direction = np.asarray(camera.transform, dtype=np.float64)[:3, :3] @ local
    origin = np.broadcast_to(camera.position[:, None], direction.shape)
    return origin, direction / np.linalg.norm(direction, axis=0)


def box_pixels(camera: Camera, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels whose ray meets the box [low, high] in front of the camera."""
    origin, direction = pixel_rays(camera, np.arange(camera.w * camera.h))
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low[:, None] - origin) / direction, (high[:, None] - origin) / direction
    near, far = np.fmin(a, b).max(0), np.fmax(a, b).min(0)
    return (far > np.maximum(near, 0)).reshape(camera.h, camera.w)
