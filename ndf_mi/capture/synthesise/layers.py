"""The surface layers of the performer, with colours and skinning weights, and their tools."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from ndf_mi.body.body import Body
from ndf_mi.body.mesh import vertex_normals
from ndf_mi.capture.synthesise.drape import Drape
from ndf_mi.capture.synthesise.folds import Folds
from ndf_mi.capture.synthesise.surface import averaging, clip, loop_subdivision


@dataclass(frozen=True)
class Picture:
    """A picture on a surface.

    Attributes:
        colour: (h, w, 3) float32 linear reflectance in [0, 1].
        wrap: beyond [0, 1]: ``repeat``, ``mirror`` or ``clamp``.
        opaque: (h, w) float32, 1 where there is a surface and 0 where there is none; None: everywhere.
    """

    colour: np.ndarray
    wrap: str = "repeat"
    opaque: np.ndarray | None = None


@dataclass(frozen=True)
class Layer:
    """One surface of the performer at rest, N vertices and F triangles.

    Attributes:
        name: for messages.
        material: a key of ``lighting.MATERIALS``.
        faces: (F, 3) int32.
        rest: (N, 3) metres, including the distance from the body.
        weights: (N, J) skinning weights.
        colour: (N, 3) linear reflectance in [0, 1].
        clearance: least distance of every vertex from the body, metres; None if it may touch the body.
        slack: (N,) metres by which folding cloth sinks where it hangs from a limb that is not vertical.
        folds: its wrinkles, displacements along the normal, or None.
        drape: how it hangs from its first vertices, one a column of the drape; without one, it is skinned.
        uv: (N, 2) places in the picture, v downwards.
        picture: its colour in place of ``colour``, or None.
    """

    name: str
    material: str
    faces: np.ndarray
    rest: np.ndarray
    weights: np.ndarray
    colour: np.ndarray
    clearance: float | None = None
    slack: np.ndarray | float = 0.0
    folds: Folds | None = None
    drape: Drape | None = None
    uv: np.ndarray | None = None
    picture: Picture | None = None


@dataclass(frozen=True)
class Sheet:
    """A skinned surface before it is a layer: (N, 3) rest vertices, (N, J) weights, (N, 2) UVs."""

    rest: np.ndarray
    weights: np.ndarray
    uv: np.ndarray
    faces: np.ndarray

    @classmethod
    def of(cls, source: Body, shape: np.ndarray) -> Sheet:
        """The surface at the shape coefficients ``shape``; at UV seams a vertex gets one of its UVs."""
        assert source.template is not None and source.weights is not None and source.shape_dirs is not None
        rest = source.template + source.shape_dirs @ shape
        uv = np.zeros((len(rest), 2))
        uv[source.faces.ravel()] = source.uv[source.uv_faces.ravel()]
        return cls(rest.astype(np.float64), source.weights.astype(np.float64), uv, source.faces)

    @property
    def normals(self) -> np.ndarray:
        return vertex_normals(self.rest, self.faces)

    def subdivided(self, times: int = 1) -> Sheet:
        sheet = self
        for _ in range(times):
            sheet = sheet._mapped(*loop_subdivision(sheet.faces, len(sheet.rest)))
        return sheet

    def clipped(self, values: np.ndarray) -> Sheet:
        """The part where ``values``, (N,), are positive."""
        return self._mapped(*clip(self.faces, values))

    def _mapped(self, matrix: csr_matrix, faces: np.ndarray) -> Sheet:
        return Sheet(matrix @ self.rest, matrix @ self.weights, matrix @ self.uv, faces)

    def eased(self, positions: int, weights: int) -> Sheet:
        """Averaged so many times: cloth bridges hollows of the body and bends over longer stretches."""
        mean = averaging(self.faces, len(self.rest))
        rest, blend = self.rest, self.weights
        for _ in range(positions):
            rest = mean @ rest
        for _ in range(weights):
            blend = mean @ blend
        return Sheet(rest, blend, self.uv, self.faces)

    def layer(self, name: str, material: str, colour: np.ndarray, clearance: float | None = None) -> Layer:
        """The surface as a layer that does not fold."""
        return Layer(name, material, self.faces, self.rest, self.weights, colour, clearance)


class Frame:
    """Limb coordinates of points ``rest``, (N, 3), with skinning ``weights``, (N, J), on a body at the
    coefficients ``shape``, (B,): positions along and around arms, legs and trunk.

    Attributes (all (N,)):
        left: whether x > 0, on the performer's left.
        arm: sum of the weights of the arm's joints without the shoulder.
        arm_s: metres from the shoulder joint along the arm; arm_phi: angle around it.
        elbow, wrist: ``arm_s`` of these joints (scalars).
        leg_phi: angle around the leg; trunk_phi: around the trunk; both 0 in front, growing towards the left.
        x, y, z: the coordinates, metres.
    """

    def __init__(self, body: Body, shape: np.ndarray, rest: np.ndarray, weights: np.ndarray) -> None:
        assert body.joint_names is not None and body.joints is not None and body.joint_dirs is not None
        names = body.joint_names
        at = dict(zip(names, body.joints + body.joint_dirs @ shape, strict=True))
        self.joints = at
        self.x, self.y, self.z = rest.T
        self.left = self.x > 0
        arms = [i for i, n in enumerate(names) if any(p in n for p in ("Arm", "Hand", "Thumb", "Finger"))]
        self.arm = weights[:, arms].sum(axis=1)
        mirrored = np.stack([np.abs(self.x), self.y, self.z], axis=1)
        shoulder, elbow, wrist = (at[f"Left{n}"] for n in ("Arm", "ForeArm", "Hand"))
        upper, lower = elbow - shoulder, wrist - elbow
        self.elbow = float(np.linalg.norm(upper))
        self.wrist = self.elbow + float(np.linalg.norm(lower))
        upper, lower = upper / np.linalg.norm(upper), lower / np.linalg.norm(lower)
        above = np.minimum((mirrored - shoulder) @ upper, self.elbow)
        self.arm_s = above + np.maximum((mirrored - elbow) @ lower, 0)
        forward = np.array([0.0, 0.0, 1.0])
        across = np.cross(upper, forward)
        centre = shoulder + np.clip(self.arm_s, 0, self.elbow)[:, None] * upper
        self.arm_phi = np.arctan2((mirrored - centre) @ across, (mirrored - centre) @ forward)
        hip, knee, ankle = (at[f"Left{n}"] for n in ("UpLeg", "Leg", "Foot"))
        heights = np.array([ankle[1], knee[1], hip[1]])
        axis = [np.interp(self.y, heights, [ankle[i], knee[i], hip[i]]) for i in (0, 2)]
        self.leg_phi = np.arctan2(np.abs(self.x) - axis[0], self.z - axis[1])
        self.trunk_phi = np.arctan2(self.x, self.z - 0.02)
        self.knee = float(knee[1])


def rise(values: np.ndarray, start: float, end: float) -> np.ndarray:
    """Smoothstep: 0 at ``start``, 1 at ``end`` (either order), flat beyond."""
    t = np.clip((values - start) / (end - start), 0, 1)
    return t * t * (3 - 2 * t)


def waves(points: np.ndarray, wavelength: float, seed: int, count: int = 24) -> np.ndarray:
    """(N,) smooth noise of about unit deviation: random plane waves of ``wavelength`` metres."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    frequency = 2 * np.pi / wavelength * random.uniform(0.6, 1.4, count)
    phase = random.uniform(0, 2 * np.pi, count)
    return np.sin(points @ (directions * frequency[:, None]).T + phase).sum(axis=1) * np.sqrt(2 / count)
