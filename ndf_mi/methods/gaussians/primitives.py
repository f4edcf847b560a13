"""Gaussian primitives that are bound to the triangles of a body, and their places in its poses."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.mesh import vertex_normals
from ndf_mi.body.poses import Poses
from ndf_mi.methods.gaussians.compositing import Posed

LEARNED = {"offset": 3, "rotation": 4, "log_scale": 3, "logit_opacity": 1, "colour": 3, "feature": 8}
"""What training changes of a primitive, by name, and how many numbers each is."""

LIGHT = 24
"""Numbers that describe the light; see `pose`."""

CACHED = 64
"""Frames of primitives that are kept."""

Arrays = dict[str, np.ndarray]


@dataclass(frozen=True)
class Binding:
    """Where N primitives are bound to.

    Attributes:
        triangle: (N,) int32 index.
        barycentric: (N, 3) float32, the place on the triangle.
    """

    triangle: np.ndarray
    barycentric: np.ndarray

    def __len__(self) -> int:
        return len(self.triangle)

    def select(self, index: np.ndarray) -> Binding:
        """Those with these indices, (M,) int."""
        return Binding(self.triangle[index], self.barycentric[index])


def spread(vertices: np.ndarray, faces: np.ndarray, spacing: float, rng: np.random.Generator) -> Binding:
    """Places all over a surface, at random, one on `spacing`² of its area.

    Args:
        vertices: (V, 3) metres.
        faces: (F, 3).
        spacing: metres.
    """
    area = areas(vertices, faces)
    count = max(round(area.sum() / spacing**2), 1)
    # One in each of equal shares of the area, in the order of the triangles.
    share = (np.arange(count) + rng.random(count)) / count
    triangle = np.searchsorted(np.cumsum(area) / area.sum(), share).clip(0, len(faces) - 1)
    root, second = np.sqrt(rng.random(count)), rng.random(count)
    barycentric = np.stack([1 - root, root * (1 - second), root * second], 1)
    return Binding(triangle.astype(np.int32), barycentric.astype(np.float32))


def areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F,) float64 areas of triangles."""
    corners = vertices[faces].astype(np.float64)
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2


def initial(count: int, colour: np.ndarray, rng: np.random.Generator) -> Arrays:
    """Flat primitives on the surface, by the names of `LEARNED`, (k, count) float32 each.

    Args:
        colour: (3,) sRGB of all of them.
        rng: source of the features, which nothing else tells apart.
    """
    learned = {name: np.zeros((size, count), np.float32) for name, size in LEARNED.items()}
    learned["rotation"][3] = 1
    learned["log_scale"][:] = np.log([[0.6], [0.6], [0.2]])
    learned["logit_opacity"][:] = 1
    learned["colour"][:] = np.asarray(colour)[:, None]
    learned["feature"][:] = rng.normal(0, 0.1, learned["feature"].shape)
    return learned


@dataclass(frozen=True)
class Frames:
    """N frames of reference on a body in one pose, world space.

    Attributes:
        place: origins, metres.
        rotation: from tangent, bitangent and normal to world space.
        normal: of the smooth surface.
    """

    place: mi.Point3f
    rotation: mi.Quaternion4f
    normal: mi.Vector3f


class Rig:
    """The body that primitives are bound to, at rest and in all its poses.

    Args:
        faces: (F, 3) triangles.
        poses: vertices in every frame.
        rest: (V, 3) metres, vertices at rest.

    Attributes:
        faces, poses: those given.
    """

    def __init__(self, faces: np.ndarray, poses: Poses, rest: np.ndarray) -> None:
        self.faces, self.poses, self._rest = faces, poses, rest
        self._binding: Binding | None = None
        self._at_rest = mi.Point3f()
        self._known: OrderedDict[int, Frames] = OrderedDict()

    def at_rest(self, binding: Binding) -> mi.Point3f:
        """The places of primitives on the body at rest."""
        self._bind(binding)
        return self._at_rest

    def frames(self, binding: Binding, frame: int) -> Frames:
        """The frames of reference of primitives at a frame of the poses. Those of the last binding are kept.

        The normal is interpolated from the vertices' normals; the tangent is along the first edge of the
        triangle.

        Raises:
            InputError: there is no such frame.
        """
        self._bind(binding)
        if frame not in self._known:
            self._known[frame] = self._place(binding, self.poses.vertices[self.poses.index(frame)])
            if len(self._known) > CACHED:
                self._known.popitem(last=False)
        return self._known[frame]

    def _bind(self, binding: Binding) -> None:
        if binding is not self._binding:
            self._binding = binding
            self._known.clear()
            place = (self._rest[self.faces[binding.triangle]] * binding.barycentric[:, :, None]).sum(1)
            self._at_rest = mi.Point3f(np.ascontiguousarray(place.T, np.float32))

    def _place(self, binding: Binding, vertices: np.ndarray) -> Frames:
        corner, weights = self.faces[binding.triangle], binding.barycentric[:, :, None]
        corners = vertices[corner].astype(np.float64)
        edge = corners[:, 1] - corners[:, 0]
        normal = (vertex_normals(vertices, self.faces)[corner] * weights).sum(1)
        normal = _unit(normal, np.cross(edge, corners[:, 2] - corners[:, 0]))
        across = np.eye(3)[np.abs(normal).argmin(axis=1)]
        tangent = _unit(_tangential(edge, normal), _tangential(across, normal))
        matrix = np.stack([tangent, np.cross(normal, tangent), normal], axis=-1)
        parts = ((corners * weights).sum(1), Rotation.from_matrix(matrix).as_quat(), normal)
        place, rotation, up = (np.ascontiguousarray(part.T, np.float32) for part in parts)
        return Frames(mi.Point3f(place), mi.Quaternion4f(rotation), mi.Vector3f(up))


def rows(learned: Mapping[str, mi.Float]) -> dict[str, list[mi.Float]]:
    """What is learned of N primitives, k rows of N by the names of `LEARNED`, from flat arrays."""
    count = dr.width(learned["logit_opacity"])
    index = dr.arange(mi.UInt32, count)
    return {name: [dr.gather(mi.Float, learned[name], index + row * count) for row in range(size)]
            for name, size in LEARNED.items()}


def pose(learned: Mapping[str, list[mi.Float]], light: mi.Float, frames: Frames, spacing: float,
         smallest: float, change: tuple[mi.Vector3f, mi.Color3f] | None = None) -> Posed:
    """Primitives in a pose, attached to what training changes.

    Args:
        learned: `rows` by the names of `LEARNED`: `offset` in the frame of reference, in `spacing`;
            `rotation` in it, a quaternion (x, y, z, w) of any length; `log_scale`, logarithms of the standard
            deviations in `spacing`; `logit_opacity`; `colour` in sRGB.
        light: `LIGHT` numbers, the same for all primitives: colours are multiplied by 1 plus these
            coefficients times the spherical harmonics of the surface's normal in world space, from degree 1
            to 2, channel by channel. This is what diffuse light does (Ramamoorthi and Hanrahan 2001).
        frames: of reference.
        spacing: metres.
        smallest: metres, which all standard deviations exceed.
        change: offsets, in `spacing`, and colours to add.
    """
    matrix = dr.quat_to_matrix(mi.Matrix3f, frames.rotation)
    harmonics = dr.sh_eval(frames.normal, 2)[1:]
    shade = [1.0 + sum((dr.gather(mi.Float, light, mi.UInt32(channel * len(harmonics) + i)) * value
                        for i, value in enumerate(harmonics)), mi.Float(0)) for channel in range(3)]
    offset, colour = mi.Vector3f(*learned["offset"]), mi.Color3f(*learned["colour"]) * mi.Color3f(*shade)
    if change is not None:
        offset, colour = offset + change[0], colour + change[1]
    return Posed(
        centre=mi.Point3f(frames.place + matrix @ (offset * spacing)),
        scale=mi.Vector3f(smallest + spacing * dr.exp(mi.Vector3f(*learned["log_scale"]))),
        rotation=mi.Quaternion4f(dr.normalize(frames.rotation * mi.Quaternion4f(*learned["rotation"]))),
        opacity=dr.rcp(1.0 + dr.exp(-learned["logit_opacity"][0])),
        colour=dr.maximum(colour, 0.0))


def _tangential(vectors: np.ndarray, normal: np.ndarray) -> np.ndarray:
    return vectors - (vectors * normal).sum(1, keepdims=True) * normal


def _unit(vectors: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Unit vectors; along `otherwise` where the length is almost zero."""
    vectors = np.where(np.linalg.norm(vectors, axis=1, keepdims=True) > 1e-9, vectors, otherwise)
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
