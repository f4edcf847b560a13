"""Renders the performer by Mitsuba's path tracer: one scene, whose vertices move; one kernel for all cameras and frames."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.synthesise import lighting
from ndf_mi.capture.synthesise.layers import Layer

_MAX_DEPTH = 3
#: Pixels around the performer's projected box that are rendered with it.
_MARGIN = 2


class Studio:
    """The scene: light and the performer's layers.

    Args:
        layers: the surfaces; their faces, colours and materials don't change.
        spp: samples a pixel, rounded up to what Mitsuba's ``multijitter`` sampler can stratify.
    """

    def __init__(self, layers: Sequence[Layer], spp: int) -> None:
        scene: dict = {"type": "scene", "light": lighting.emitter()}
        self._keys = []
        for i, layer in enumerate(layers):
            name = f"layer{i}"
            scene[name] = _mesh(name, layer)
            self._keys.append(f"{name}.vertex_positions")
        self._scene = mi.load_dict(scene)
        self._parameters = mi.traverse(self._scene)
        self._integrator = mi.load_dict({"type": "path", "max_depth": _MAX_DEPTH, "hide_emitters": True})
        self._sampler = mi.load_dict({"type": "multijitter", "sample_count": spp})
        self._points = np.empty((0, 3))

    def pose(self, layers: Sequence[np.ndarray]) -> None:
        """Moves the layers to these world vertices, (N, 3) each."""
        for key, vertices in zip(self._keys, layers, strict=True):
            self._parameters[key] = mi.Float(np.ascontiguousarray(vertices, dtype=np.float32).ravel())
        self._parameters.update()
        self._points = np.concatenate(list(layers))

    def render(self, camera: Camera, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """The performer as ``camera`` sees it, box-filtered.

        Returns:
            (h, w, 3) float32 linear radiance, premultiplied by the coverage, and (h, w) float32 coverage in [0, 1].
        """
        left, top, width, height = _crop(camera, self._points)
        samples = self._sampler.sample_count()
        self._sampler.set_samples_per_wavefront(samples)
        self._sampler.seed(seed, width * height * samples)
        pixel = dr.arange(mi.UInt32, width * height * samples) // samples
        columns = dr.opaque(mi.UInt32, width)
        row = pixel // columns
        corner = mi.Point2f(mi.Float(pixel - row * columns), mi.Float(row))
        offset = mi.Point2f(dr.opaque(mi.Float, left), dr.opaque(mi.Float, top))
        ray = mi.RayDifferential3f(camera.rays(corner + offset + self._sampler.next_2d()))
        radiance, hit, _ = self._integrator.sample(self._scene, self._sampler, ray)
        channels = [radiance.x, radiance.y, radiance.z, dr.select(hit, mi.Float(1), 0)]
        means = [dr.block_sum(channel, samples) / samples for channel in channels]
        dr.eval(means)
        rendered = np.stack([np.array(mean).reshape(height, width) for mean in means], axis=-1)
        out = np.zeros((camera.h, camera.w, 4), dtype=np.float32)
        out[top : top + height, left : left + width] = rendered
        return out[..., :3], out[..., 3]


def _mesh(name: str, layer: Layer) -> mi.Mesh:
    properties = mi.Properties()
    properties["mesh_bsdf"] = mi.load_dict(lighting.MATERIALS[layer.material])
    mesh = mi.Mesh(name, len(layer.rest), len(layer.faces), has_vertex_normals=True, props=properties)
    mesh.add_attribute("vertex_color", 3, np.ascontiguousarray(layer.colour, dtype=np.float32).ravel())
    parameters = mi.traverse(mesh)
    parameters["faces"] = mi.UInt32(np.ascontiguousarray(layer.faces, dtype=np.uint32).ravel())
    parameters["vertex_positions"] = mi.Float(np.ascontiguousarray(layer.rest, dtype=np.float32).ravel())
    parameters.update()
    return mesh


def _crop(camera: Camera, points: np.ndarray) -> tuple[int, int, int, int]:
    """left, top, width and height of the pixels around the projected points, within the image."""
    pixels = camera.project(points)
    size = np.array([camera.w, camera.h])
    low = np.clip(np.floor(pixels.min(axis=0)).astype(int) - _MARGIN, 0, size - 1)
    high = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + _MARGIN, low + 1, size)
    (left, top), (width, height) = low, high - low
    return int(left), int(top), int(width), int(height)
