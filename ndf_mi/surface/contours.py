"""Gradients of an image in the vertices of a mesh through the motion of its contours (Li et al. 2018, edge
sampling).

Differentiating the samples of an image misses that they change sides of a contour. For a box-filtered pixel p
whose radiance f jumps along contours in the image, with n normal to the contour and x on it,

    dI_p/dv = ∫_p ∂f/∂v dA + ∫_{contours in p} (f(x - n·0) - f(x + n·0)) (n · ∂x/∂v) dl.

The second integral is estimated here by points on the contours of primary visibility, where the body ends in
front of the background and where one part of it ends in front of another. Lines along which two parts
intersect are not sampled.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import trimesh

from ndf_mi.body.mesh import opposite_half_edges
from ndf_mi.capture.camera import Camera
from ndf_mi.surface.posed_mesh import Rectangle
from ndf_mi.surface.textured import TexturedSurface

SIDE = 0.02
"""Distance from a contour, in pixels, at which the radiance of its two sides is evaluated."""

NEARER = 1 - 1e-3
"""A contour point is hidden if the mesh is met within this share of its distance."""


@dataclass(frozen=True)
class ContourSamples:
    """N points on a view's contours.

    Attributes:
        start, end: (N,) indices of the vertices of each point's edge.
        position: (N,) position between their projections, in [0, 1].
        point: (N, 2) pixel coordinates.
        normal: (N, 2) unit vectors, normal to the contour in the image.
        distance: (N,) metres from the camera.
        length: pixels of contour that each point represents.
    """

    start: np.ndarray
    end: np.ndarray
    position: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    distance: np.ndarray
    length: float


class Contours:
    """Finds and samples the contours of a mesh of fixed topology.

    A contour edge lies between a triangle that faces the camera and one that does not, and is convex (its own
    triangles hide it otherwise). All edges that do not have two triangles are contours, too.

    Args:
        faces: (F, 3). Vertices must not be doubled at texture seams, since these would become boundaries.
    """

    def __init__(self, faces: np.ndarray) -> None:
        self._faces = faces.astype(np.int64)
        edges = np.sort(trimesh.geometry.faces_to_edges(faces), axis=1)
        opposite = opposite_half_edges(faces)
        one = np.nonzero(opposite > np.arange(len(opposite)))[0]
        one = one[np.lexsort(edges[one].T[::-1])]  # by vertices, whatever the order of the triangles
        other = opposite[one]
        self._inner = edges[one]
        self._wings = np.stack([one, other], axis=1) // 3
        self._opposite = np.roll(self._faces, 1, axis=1).ravel()[other]
        self._boundary = np.unique(edges[opposite < 0], axis=0)

    def planes(self, vertices: np.ndarray) -> np.ndarray:
        """(F, 4) a normal n and n · x of the plane of each triangle, for vertices (V, 3) in metres. All
        cameras that see the same vertices can share them.
        """
        a, b, c = (vertices[self._faces[:, corner]].astype(np.float64) for corner in range(3))
        x, y, z = (b - a).T
        u, v, w = (c - a).T
        normals = np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=1)
        return np.column_stack([normals, (normals * a).sum(1)])

    def edges(self, vertices: np.ndarray, camera: Camera, planes: np.ndarray | None = None) -> np.ndarray:
        """(E, 2) vertex indices of the contour edges of the mesh with these (V, 3) vertices, metres.

        Args:
            vertices: (V, 3) world space, metres.
            camera: a pinhole camera.
            planes: of these vertices, where they are known.
        """
        if planes is None:
            planes = self.planes(vertices)
        normals = planes[:, :3]
        facing = normals @ camera.position > planes[:, 3]
        one, other = self._wings.T
        chosen = np.flatnonzero(facing[one] != facing[other])
        reach = vertices[self._opposite[chosen]] - vertices[self._inner[chosen, 0]]
        convex = (normals[one[chosen]] * reach).sum(1) < 0
        return np.concatenate([self._inner[chosen[convex]], self._boundary])

    def sample(self, vertices: np.ndarray, camera: Camera, count: int, random: np.random.Generator,
               planes: np.ndarray | None = None) -> ContourSamples | None:
        """Stratified points, uniform in length in the image.

        Args:
            vertices: (V, 3) world space, metres.
            camera: a pinhole camera.
            count: the number of points.
            random: draws their positions.
            planes: of these vertices, where they are known.

        Returns:
            the points; None if no contour is in front of the camera.
        """
        vertices = vertices.astype(np.float64)
        edges = self.edges(vertices, camera, planes)
        depth = -camera.to_camera(vertices)[:, 2]
        edges = edges[(depth[edges] > 0).all(axis=1)]
        ends = camera.project(vertices[edges.ravel()]).reshape(-1, 2, 2)
        along = ends[:, 1] - ends[:, 0]
        lengths = np.linalg.norm(along, axis=1)
        above = np.cumsum(lengths)
        if not len(above) or above[-1] == 0:
            return None
        at = (np.arange(count) + random.random(count)) * (above[-1] / count)
        index = np.minimum(np.searchsorted(above, at, side="right"), len(above) - 1)
        length = np.maximum(lengths[index], 1e-12)
        position = np.clip((at - above[index]) / length + 1, 0, 1)
        start, end = edges[index].T
        # The inverse of the depth is linear in the image.
        share = position * depth[start] / (position * depth[start] + (1 - position) * depth[end])
        world = vertices[start] + share[:, None] * (vertices[end] - vertices[start])
        return ContourSamples(
            start, end, position,
            point=ends[index, 0] + position[:, None] * along[index],
            normal=np.stack([along[index, 1], -along[index, 0]], axis=1) / length[:, None],
            distance=np.linalg.norm(world - camera.position, axis=1),
            length=float(above[-1] / count),
        )


def contour_gradient(surface: TexturedSurface, vertices: np.ndarray, camera: Camera, samples: ContourSamples,
                     adjoint: mi.TensorXf, rectangle: Rectangle) -> np.ndarray:
    """(V, 3) the part of a loss's gradient in world positions that comes from the motion of contours.

    Args:
        surface: what the camera sees; its vertices must be these.
        vertices: (V, 3) world space, metres.
        camera: a pinhole camera.
        samples: points on this camera's contours.
        adjoint: (h, w, 4), the gradient of the loss in `TexturedSurface.layers` of the rectangle.
        rectangle: the part of the image that the loss depends on.
    """
    motion = samples.length * _jump(surface, camera, samples, adjoint, rectangle)
    gradient = np.zeros_like(vertices, dtype=np.float64)
    for index, share in ((samples.start, 1 - samples.position), (samples.end, samples.position)):
        along = (motion * share)[:, None] * projection_vjp(camera, vertices[index], samples.normal)
        for axis in range(3):
            gradient[:, axis] += np.bincount(index, along[:, axis], minlength=len(vertices))
    return gradient


def _jump(surface: TexturedSurface, camera: Camera, samples: ContourSamples, adjoint: mi.TensorXf,
          rectangle: Rectangle) -> np.ndarray:
    """(N,) change of the loss for each pixel of contour and pixel of motion along its normal; 0 at hidden
    points.
    """
    with dr.suspend_grad():
        point, normal = (
            mi.Point2f(*(mi.Float(np.ascontiguousarray(xy[:, i], dtype=np.float32)) for i in range(2)))
            for xy in (samples.point, samples.normal)
        )
        x, y, width, height = rectangle
        column, row = (mi.Int32(dr.floor(point[i] - dr.opaque(mi.Float, low)))
                       for i, low in enumerate((x, y)))
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        ray = camera.rays(point)
        ray.maxt = mi.Float(samples.distance.astype(np.float32)) * NEARER
        visible = inside & ~surface.hits(ray, inside)
        behind, ahead = (surface.radiance(camera.rays(point + side * SIDE * normal), visible)
                         for side in (-1.0, 1.0))
        first = mi.UInt32(dr.select(inside, row * width + column, 0)) * 4
        jump = mi.Float(0)
        for channel in range(4):
            weight = dr.gather(mi.Float, adjoint.array, first + channel, visible)
            jump += weight * (behind[channel] - ahead[channel])
        return dr.select(visible, jump, 0).numpy().astype(np.float64)


def projection_vjp(camera: Camera, points: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(N, 3) the gradients of v · project(X) in world points X (N, 3), for pixel vectors v (N, 2)."""
    x, y, z = camera.to_camera(points).T
    scale = camera.fl_x / z
    along = (vectors[:, 0] * x - vectors[:, 1] * y) / z
    local = np.stack([-vectors[:, 0], vectors[:, 1], along], axis=1)
    return (scale[:, None] * local) @ np.asarray(camera.transform, dtype=np.float64)[:3, :3].T
