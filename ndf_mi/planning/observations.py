"""Training images as observations of the posed body's surface: a row a pixel, by ray casting, so that what is seen is what is visible."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import binary_dilation, binary_erosion

from ndf_mi.body.mesh import vertex_normals
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.mitsuba_mesh import make_mesh, set_vertices

#: Cosine between normal and view below which a pixel is left out: it spans several of its neighbours' surface.
GRAZING = 0.35


@dataclass(frozen=True)
class Observations:
    """N pixels of the training images that lie well within the mask and whose rays meet the body.

    Attributes:
        colour: (N, 3) sRGB in [0, 1].
        triangle: (N,) int of the body.
        uv: (N, 2) texture coordinates.
        rest, rest_normal: (N, 3) the point and its unit normal on the body at rest, metres.
        normal, away: (N, 3) unit, world: the body's smooth normal, and the direction towards the camera.
        turned: (N, 8) harmonics of the normal, less their mean over the frames looked at: zero where the performer never turns.
        aside: (N, 3) `away` as the body at rest would see it, its triangle carried back.
        footprint: (N,) metres that a pixel's side spans at the point's distance, facing it.
        camera, frame: (N,) int numbers of the training split's cameras, and of the frames looked at.
    """

    colour: np.ndarray
    triangle: np.ndarray
    uv: np.ndarray
    rest: np.ndarray
    rest_normal: np.ndarray
    normal: np.ndarray
    away: np.ndarray
    turned: np.ndarray
    aside: np.ndarray
    footprint: np.ndarray
    camera: np.ndarray
    frame: np.ndarray

    @property
    def cameras(self) -> int:
        return int(self.camera.max()) + 1

    @property
    def frames(self) -> int:
        return int(self.frame.max()) + 1


@dataclass(frozen=True)
class View:
    """A training image beside the body's projection in it.

    Attributes:
        camera, frame: numbers as in :class:`Observations`.
        image: (h, w, 3) sRGB; mask: (h, w) bool; body: (h, w) bool, whether the ray through the pixel's centre meets the body.
    """

    camera: int
    frame: int
    image: np.ndarray
    mask: np.ndarray
    body: np.ndarray


#: Pixels of all images looked at together: they are held at once, the body's with some 250 bytes each.
MOST_PIXELS = 100_000_000


def chosen_frames(capture: Capture, most: int) -> tuple[int, ...]:
    """At most so many of the training frames, evenly spaced; fewer where their images have more pixels than :data:`MOST_PIXELS`, though two
    where there are two."""
    frames = capture.splits["train"].frames
    pixels = sum(capture.cameras[name].w * capture.cameras[name].h for name in capture.splits["train"].cameras)
    count = min(most, len(frames), max(2, MOST_PIXELS // max(pixels, 1)))
    return tuple(frames[i] for i in np.floor((np.arange(count) + 0.5) / max(count, 1) * len(frames)).astype(int))


def observe(capture: Capture, frames: tuple[int, ...]) -> tuple[Observations, list[View]]:
    """Looks at the training cameras' images of these frames.

    Raises:
        InputError: no pixel of any image shows the body.
    """
    body, poses = capture.body, capture.poses
    rest = (poses.vertices[0] if body.template is None else body.template).astype(np.float64)
    rest_normals = vertex_normals(rest, body.faces)
    posed = [poses.vertices[poses.index(frame)].astype(np.float64) for frame in frames]
    shading = [harmonics(vertex_normals(vertices, body.faces)) for vertices in posed]
    usual = np.mean(shading, axis=0)
    back = triangle_frames(rest, body.faces)
    caster = _Caster(body.faces, len(rest))
    parts: list[dict[str, np.ndarray]] = []
    views: list[View] = []
    for row, frame in enumerate(frames):
        vertices = posed[row]
        normals = vertex_normals(vertices, body.faces)
        carried = np.einsum("fki,fkj->fij", back, triangle_frames(vertices, body.faces))
        caster.pose(vertices)
        for column, name in enumerate(capture.splits["train"].cameras):
            camera, image, mask = capture.cameras[name], capture.image(name, frame), capture.mask(name, frame)
            triangle, weights = caster.cast(camera)
            hit = triangle >= 0
            views.append(View(column, row, image, mask, hit))
            # Pixels at the mask's or the body's edge show something else in part.
            sure = _inner(mask) & _inner(hit)
            t, w = triangle[sure], weights[sure]
            point, normal = _mix(vertices, body.faces[t], w), _unit(_mix(normals, body.faces[t], w))
            away = camera.position - point
            depth = -camera.to_camera(point)[:, 2]
            keep = np.sum(_unit(away) * normal, axis=1) > GRAZING
            count = int(keep.sum())
            parts.append({
                "colour": image[sure][keep].astype(np.float64),
                "triangle": t[keep],
                "uv": _mix(body.uv.astype(np.float64), body.uv_faces[t], w)[keep],
                "rest": _mix(rest, body.faces[t], w)[keep],
                "rest_normal": _unit(_mix(rest_normals, body.faces[t], w))[keep],
                "normal": normal[keep],
                "away": _unit(away)[keep],
                "turned": _mix(shading[row] - usual, body.faces[t], w)[keep],
                "aside": np.einsum("nij,nj->ni", carried[t], _unit(away))[keep],
                "footprint": (depth / camera.fl_x)[keep],
                "camera": np.full(count, column),
                "frame": np.full(count, row),
            })
    seen = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not len(seen["camera"]):
        raise InputError(capture.path, "no training image in which the body lies within the mask", "masks and a body that agree")
    return Observations(**seen), views


class _Caster:
    """First hits of pixels' rays on the body, by Mitsuba."""

    def __init__(self, faces: np.ndarray, vertices: int) -> None:
        self._scene = mi.load_dict({"type": "scene", "body": make_mesh("body", np.zeros((vertices, 3)), faces)})
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
        # What misses leave there is anything, signalling NaN included.
        b = np.array(dr.select(hit, found.prim_uv, 0)).T
        weights = np.concatenate([1 - b.sum(axis=1, keepdims=True), b], axis=1).astype(np.float64)
        return triangle.reshape(camera.h, camera.w), weights.reshape(camera.h, camera.w, 3)


def edge(mask: np.ndarray) -> np.ndarray:
    """(h, w) bool: pixels whose 3 × 3 neighbours are both inside and outside."""
    around = np.ones((3, 3), dtype=bool)
    return binary_dilation(mask, around) & ~binary_erosion(mask, around, border_value=1)


def harmonics(d: np.ndarray) -> np.ndarray:
    """(N, 8) polynomials of unit vectors (N, 3) that span the real spherical harmonics of the first and second order, not normalised.
    Irradiance is made of these and a constant to within a few percent (Ramamoorthi and Hanrahan 2001)."""
    x, y, z = d.T
    return np.stack([x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], axis=1)


def triangle_frames(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 3) orthonormal rows of each triangle: along its first edge, across it, and the normal; zero rows where it has no area."""
    a, b, c = (vertices[corner] for corner in faces.T)
    along = _unit(b - a)
    normal = _unit(np.cross(b - a, c - a))
    return np.stack([along, np.cross(normal, along), normal], axis=1)


def _inner(mask: np.ndarray) -> np.ndarray:
    return binary_erosion(mask, np.ones((3, 3), dtype=bool))


def _mix(values: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return np.einsum("nk,nkd->nd", weights, values[corners])


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)
