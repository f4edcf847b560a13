"""Training pixels as observations of the posed body's surface, by ray casting."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import binary_erosion

from ndf_mi.body.mesh import vertex_normals
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.mitsuba_mesh import make_mesh, set_vertices

#: Cosine between normal and view below which pixels are ignored, because they span the surface of several
#: neighbours.
GRAZING = 0.35
#: Limit on the pixels of all images read: they are held in memory, those on the body with about 250 bytes
#: each.
MOST_PIXELS = 100_000_000


@dataclass(frozen=True)
class Observations:
    """N pixels of the training images that lie well within the mask and whose rays hit the body.

    Attributes:
        colour: (N, 3) sRGB in [0, 1].
        triangle: (N,) int triangle of the body.
        uv: (N, 2) texture coordinates.
        rest, rest_normal: (N, 3) the point, in metres, and its unit normal on the body at rest.
        normal, to_camera: (N, 3) unit vectors in world space: the body's smooth normal, and the direction to
            the camera.
        shading: (N, 8) harmonics of the normal minus their mean over the frames; 0 if the performer never
            turns.
        to_camera_rest: (N, 3) `to_camera` carried back to the body at rest with its triangle.
        footprint: (N,) side of a pixel in metres at the point's distance, on a surface that faces the camera.
        camera, frame: (N,) int indices of the training cameras and of the frames read.
    """

    colour: np.ndarray
    triangle: np.ndarray
    uv: np.ndarray
    rest: np.ndarray
    rest_normal: np.ndarray
    normal: np.ndarray
    to_camera: np.ndarray
    shading: np.ndarray
    to_camera_rest: np.ndarray
    footprint: np.ndarray
    camera: np.ndarray
    frame: np.ndarray


@dataclass(frozen=True)
class View:
    """A training image and the body's projection in it.

    Attributes:
        camera, frame: indices as in :class:`Observations`.
        image: (h, w, 3) sRGB.
        mask: (h, w) bool.
        body: (h, w) bool, whether the ray through the pixel's centre hits the body.
    """

    camera: int
    frame: int
    image: np.ndarray
    mask: np.ndarray
    body: np.ndarray


def chosen_frames(capture: Capture, most: int) -> tuple[int, ...]:
    """Up to `most` training frames, evenly spaced.

    Fewer if their images have more than :data:`MOST_PIXELS` pixels, but at least two where there are two.
    """
    frames = capture.splits["train"].frames
    pixels = sum(capture.cameras[name].w * capture.cameras[name].h
                 for name in capture.splits["train"].cameras)
    count = min(most, len(frames), max(2, MOST_PIXELS // max(pixels, 1)))
    return tuple(frames[i]
                 for i in np.floor((np.arange(count) + 0.5) / max(count, 1) * len(frames)).astype(int))


def observe(capture: Capture, frames: tuple[int, ...]) -> tuple[Observations, list[View]]:
    """Reads the training cameras' images of these frames.

    Raises:
        InputError: no pixel of any image shows the body.
    """
    body, poses = capture.body, capture.poses
    rest = (poses.vertices[0] if body.template is None else body.template).astype(np.float64)
    rest_normals = vertex_normals(rest, body.faces)
    posed = [poses.vertices[poses.index(frame)].astype(np.float64) for frame in frames]
    shading = [harmonics(vertex_normals(vertices, body.faces)) for vertices in posed]
    mean_shading = np.mean(shading, axis=0)
    rest_frames = triangle_frames(rest, body.faces)
    caster = _Caster(body.faces, len(rest))
    parts: list[dict[str, np.ndarray]] = []
    views: list[View] = []
    for row, frame in enumerate(frames):
        vertices = posed[row]
        normals = vertex_normals(vertices, body.faces)
        to_rest = np.einsum("fki,fkj->fij", rest_frames, triangle_frames(vertices, body.faces))
        caster.pose(vertices)
        for column, name in enumerate(capture.splits["train"].cameras):
            camera, image, mask = capture.cameras[name], capture.image(name, frame), capture.mask(name, frame)
            triangle, weights = caster.cast(camera)
            hit = triangle >= 0
            views.append(View(column, row, image, mask, hit))
            # Pixels at the edge of the mask or the body partly show something else.
            inner = inner_pixels(mask) & inner_pixels(hit)
            t, w = triangle[inner], weights[inner]
            point, normal = _mix(vertices, body.faces[t], w), _unit(_mix(normals, body.faces[t], w))
            depth = -camera.to_camera(point)[:, 2]
            to_camera = _unit(camera.position - point)
            keep = np.sum(to_camera * normal, axis=1) > GRAZING
            count = int(keep.sum())
            parts.append({
                "colour": image[inner][keep].astype(np.float64),
                "triangle": t[keep],
                "uv": _mix(body.uv.astype(np.float64), body.uv_faces[t], w)[keep],
                "rest": _mix(rest, body.faces[t], w)[keep],
                "rest_normal": _unit(_mix(rest_normals, body.faces[t], w))[keep],
                "normal": normal[keep],
                "to_camera": to_camera[keep],
                "shading": _mix(shading[row] - mean_shading, body.faces[t], w)[keep],
                "to_camera_rest": np.einsum("nij,nj->ni", to_rest[t], to_camera)[keep],
                "footprint": (depth / camera.fl_x)[keep],
                "camera": np.full(count, column),
                "frame": np.full(count, row),
            })
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not len(columns["camera"]):
        raise InputError(capture.path, "no training image in which the body lies within the mask",
                         "masks and a body that agree")
    return Observations(**columns), views


class _Caster:
    """First hits of pixels' rays on the body."""

    def __init__(self, faces: np.ndarray, vertices: int) -> None:
        self._scene = mi.load_dict({"type": "scene",
                                    "body": make_mesh("body", np.zeros((vertices, 3)), faces)})
        self._parameters = mi.traverse(self._scene)

    def pose(self, vertices: np.ndarray) -> None:
        """Moves the body to (V, 3) world vertices."""
        set_vertices(self._parameters, vertices, "body")
        self._parameters.update()

    def cast(self, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """(h, w) int triangle through each pixel's centre, -1 for none, and (h, w, 3) barycentric weights."""
        index = dr.arange(mi.UInt32, camera.w * camera.h)
        width = dr.opaque(mi.UInt32, camera.w)
        row = index // width
        ray = camera.rays(mi.Point2f(mi.Float(index - row * width), mi.Float(row)) + 0.5)
        found = self._scene.ray_intersect_preliminary(ray)
        hit = found.is_valid()
        triangle = np.array(dr.select(hit, mi.Int32(found.prim_index), -1))
        # Undefined where nothing was hit, possibly a signalling NaN.
        b = np.array(dr.select(hit, found.prim_uv, 0)).T
        weights = np.concatenate([1 - b.sum(axis=1, keepdims=True), b], axis=1).astype(np.float64)
        return triangle.reshape(camera.h, camera.w), weights.reshape(camera.h, camera.w, 3)


def harmonics(d: np.ndarray) -> np.ndarray:
    """(N, 8) polynomials of unit vectors (N, 3) that span the real spherical harmonics of orders 1 and 2,
    unnormalised.

    With a constant they represent irradiance to within a few percent (Ramamoorthi and Hanrahan 2001).
    """
    x, y, z = d.T
    return np.stack([x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], axis=1)


def triangle_frames(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 3) orthonormal rows: along the first edge, across it, the normal; zeros if degenerate."""
    a, b, c = (vertices[corner] for corner in faces.T)
    along = _unit(b - a)
    normal = _unit(np.cross(b - a, c - a))
    return np.stack([along, np.cross(normal, along), normal], axis=1)


def inner_pixels(mask: np.ndarray, by: int = 1) -> np.ndarray:
    """(h, w) bool: pixels whose neighbours up to `by` pixels away are all in the mask."""
    return binary_erosion(mask, np.ones((2 * by + 1, 2 * by + 1), dtype=bool))


def _mix(values: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.einsum("nk,nkd->nd", weights, values[corners])


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
