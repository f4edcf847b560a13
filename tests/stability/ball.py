"""A run around a ball whose density is a known function of the distance l alone."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mitsuba as mi
import numpy as np
import trimesh

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.camera import Camera
from ndf_mi.field import Preset, preset
from ndf_mi.run import Run
from ndf_mi.stability.curves import decode

RADIUS = 0.3
PEAK, SLOPE, LOW, HIGH = 0.5, 12.0, 0.005, 0.03
"""The density is greatest between the distances LOW and HIGH in metres. PEAK is roughly its logarithm there,
SLOPE how fast that falls."""
GREY = 0.5
"""The colour, sRGB."""
GREY_LINEAR = float(decode(np.array(GREY)))


def icosphere(subdivisions: int = 2, radius: float = RADIUS) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) float32 vertices and (F, 3) faces of a ball around the origin."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)


def charts(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Texture coordinates (3F, 2) and indices (F, 3) in which each of `count` triangles is a chart."""
    side = int(np.ceil(np.sqrt(count)))
    corner = np.stack([np.arange(count) % side, np.arange(count) // side], 1)
    offsets = np.array([[0.1, 0.1], [0.8, 0.2], [0.3, 0.9]])
    uv = ((corner[:, None] + offsets) / side).reshape(-1, 2).astype(np.float32)
    return uv, np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def looking(origin: np.ndarray, forward: np.ndarray, size: int = 8, focal: float = 1.0) -> Camera:
    """A camera at `origin` with `size` × `size` pixels and a focal length of `focal` times their width."""
    back = -forward / np.linalg.norm(forward)
    right = np.cross([0.31, 0.9, 0.2], back)
    right /= np.linalg.norm(right)
    transform = np.eye(4)
    transform[:3] = np.stack([right, np.cross(back, right), back, origin], 1)
    return Camera("camera", size, size, focal * size, focal * size, size / 2, size / 2, transform)


@dataclasses.dataclass
class Ridge:
    """A run with density σ = limit·(1 − exp(−gain·softplus(z) / limit))·fade, where z = peak − slope·(max(l*
    − high*, 0) + max(low* − l*, 0)).

    The asterisk maps −`band_inside` … `band` to 0 … 1.

    Attributes:
        run: around the ball.
        peak: index of PEAK among the weights.
    """

    run: Run
    peak: int

    @property
    def vertices(self) -> np.ndarray:
        """(V, 3) float32."""
        return self.run.poses.vertices[0]

    @property
    def faces(self) -> np.ndarray:
        """(F, 3)."""
        return self.run.body.faces

    @property
    def preset(self) -> Preset:
        """The run's."""
        return self.run.model.field.preset

    def set_weights(self, weights: np.ndarray) -> None:
        """Replaces the networks' weights."""
        self.run.parameters = self.run.parameters.replace(weights=mi.Float(weights))

    def density(self, l: np.ndarray, peak: float = PEAK) -> np.ndarray:
        """σ in 1/m at distances l, float64."""
        p = self.preset
        size = p.band / 0.08
        unit, low, high = (
            (at + p.band_inside) / (p.band + p.band_inside) for at in (l, size * LOW, size * HIGH))
        z = peak - SLOPE * (np.maximum(unit - high, 0) + np.maximum(low - unit, 0))
        sigma = -p.density_limit * np.expm1(-p.density_gain * np.logaddexp(0, z) / p.density_limit)
        for depth in ((p.band - l) / p.band, (p.band_inside + l) / p.band_inside):
            s = np.clip(depth / p.band_fade, 0, 1)
            sigma = sigma * s * s * (3 - 2 * s)
        return np.where((l <= p.band) & (l >= -p.band_inside), sigma, 0.0)


@contextmanager
def ridge(
    place: tuple[float, float, float] = (0.0, 0.0, 0.0), size: float = 1.0, srgb: float = GREY
) -> Iterator[Ridge]:
    """A ridge in a temporary folder, around the ball times `size`, moved to `place`; its band grows with
    it."""
    vertices, faces = icosphere(radius=RADIUS * size)
    vertices = (vertices.astype(np.float64) + place).astype(np.float32)
    uv, uv_faces = charts(len(faces))
    zeros = np.zeros((1, 3), np.float32)
    poses = Poses(np.zeros(1, np.int32), vertices[None], np.zeros((1, 1, 3), np.float32), zeros, zeros)
    shape = dataclasses.replace(
        preset("tiny"), band=0.08 * size, band_inside=0.05 * size, band_fade=0.4, encoding="frequency",
        octaves=0, deformation_layers=(), density_bias=0.0, density_gain=20.0 / size,
        density_limit=60.0 / size)
    with tempfile.TemporaryDirectory() as folder:
        run = Run.create(
            Path(folder) / "ball", shape, Body(faces, uv, uv_faces), poses, 1, background=[0.0, 0.0, 0.0])
        weights, peak = _weights(run, srgb, size)
        found = Ridge(run, peak)
        found.set_weights(weights)
        run.save()
        yield found


def _weights(run: Run, srgb: float, size: float) -> tuple[np.ndarray, int]:
    """Weights of the density above and of one colour, and the index of PEAK."""
    field, p = run.model.field, run.model.field.preset
    weights = run.parameters.weights.numpy()
    low, high = ((size * at + p.band_inside) / (p.band + p.band_inside) for at in (LOW, HIGH))

    at = field.layers["density0"]
    columns = at.inputs + at.pose
    weights[at.offset : at.offset + at.size] = 0
    weights[at.offset + 2], weights[at.offset + columns + 2] = 1, -1
    bias = at.offset + at.outputs * columns
    weights[bias], weights[bias + 1] = -high, low
    at = field.layers["density_out"]
    columns = at.inputs + at.pose
    peak = at.offset + at.outputs * columns
    weights[at.offset : at.offset + columns] = 0
    weights[at.offset], weights[at.offset + 1], weights[peak] = -SLOPE, -SLOPE, PEAK
    at = field.layers["colour_out"]
    columns = at.inputs + at.pose
    weights[at.offset : at.offset + at.outputs * columns] = 0
    weights[at.offset + at.outputs * columns : at.offset + at.size] = np.log(srgb / (1 - srgb))
    return weights, peak
