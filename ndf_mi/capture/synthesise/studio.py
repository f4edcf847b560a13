"""Renders the performer with Mitsuba's path tracer, with one kernel for all cameras and frames."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.ndimage import maximum_filter

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.synthesise import lighting
from ndf_mi.capture.synthesise.layers import Layer, Picture
from ndf_mi.mitsuba_mesh import make_mesh, set_normals, set_vertices

_MAX_DEPTH = 3
#: Holes that a ray can pass through, which Mitsuba counts as bounces.
_HOLES = 6


class Studio:
    """The scene: a light, by its name, and the performer's layers, of which only the vertices change.

    ``spp``, samples per pixel, is rounded up to a number that Mitsuba's ``multijitter`` sampler can stratify.
    ``scene`` and ``integrator`` are Mitsuba's, as they render.
    """

    def __init__(self, layers: Sequence[Layer], spp: int, light: str = lighting.DEFAULT) -> None:
        self._light = lighting.light(light)
        self._meshes = {f"layer{i}": layer.faces for i, layer in enumerate(layers)}
        scene: dict = {"type": "scene"} if self._light.flat else {"type": "scene",
                                                                   "light": lighting.emitter(light)}
        scene |= {name: _mesh(name, layer, self._light.flat)
                  for name, layer in zip(self._meshes, layers, strict=True)}
        self.scene = mi.load_dict(scene)
        self._parameters = mi.traverse(self.scene)
        holes = any(layer.picture is not None and layer.picture.opaque is not None for layer in layers)
        self.integrator = mi.load_dict({"type": "path", "max_depth": _MAX_DEPTH + _HOLES * holes,
                                         "hide_emitters": not self._light.flat})
        self._sampler = mi.load_dict({"type": "multijitter", "sample_count": spp})
        self._points = np.empty((0, 3))
        self._edge = 0.0

    def pose(self, layers: Sequence[np.ndarray], heading: float = 0.0,
             normals: Sequence[np.ndarray] | None = None) -> None:
        """Moves the layers to world vertices, (N, 3) each; a carried light turns to `heading`, radians.

        ``normals``, (N, 3) each, replace the means of adjacent triangles.
        """
        if self._light.carried:
            turn = mi.Transform4f().rotate([0, 1, 0], float(np.degrees(heading)))
            self._parameters["light.to_world"] = turn
        for name, vertices in zip(self._meshes, layers, strict=True):
            set_vertices(self._parameters, vertices, name)
        self._parameters.update()
        if normals is not None:
            for name, directions in zip(self._meshes, normals, strict=True):
                set_normals(self._parameters, directions, name)
            self._parameters.update()
        self._points = np.concatenate(list(layers))
        corners = [points[faces] for points, faces in zip(layers, self._meshes.values(), strict=True)]
        edges = (((c - np.roll(c, 1, axis=1)) ** 2).sum(axis=-1).max() for c in corners)
        self._edge = float(np.sqrt(max(edges)))

    def render(self, camera: Camera, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Renders the performer with a box filter: (h, w, 3) float32 linear radiance, premultiplied by
        coverage, and (h, w) float32 coverage in [0, 1]."""
        pixels = self._seen_pixels(camera)
        samples = self._sampler.sample_count()
        self._sampler.set_samples_per_wavefront(samples)
        self._sampler.seed(seed, len(pixels) * samples)
        pixel = dr.gather(mi.UInt32, mi.UInt32(pixels),
                          dr.arange(mi.UInt32, len(pixels) * samples) // samples)
        width = dr.opaque(mi.UInt32, camera.w)
        row = pixel // width
        position = mi.Point2f(mi.Float(pixel - row * width), mi.Float(row)) + self._sampler.next_2d()
        ray = mi.RayDifferential3f(camera.rays(position))
        radiance, hit, _ = self.integrator.sample(self.scene, self._sampler, ray)
        channels = [radiance.x, radiance.y, radiance.z, dr.select(hit, mi.Float(1), 0)]
        # Evaluated together, since each block sum would launch the path tracer again.
        dr.eval(channels)
        out = np.zeros((camera.h * camera.w, 4), dtype=np.float32)
        sums = [np.array(dr.block_sum(channel, samples)) for channel in channels]
        out[pixels] = np.stack(sums, axis=1) / samples
        image = out.reshape(camera.h, camera.w, 4)
        return image[..., :3], image[..., 3]

    def _seen_pixels(self, camera: Camera) -> np.ndarray:
        """(P,) uint32 indices of the pixels that the performer can touch: an edge or less from a vertex."""
        columns, rows = np.floor(camera.project(self._points)).astype(int).T
        inside = (columns >= 0) & (columns < camera.w) & (rows >= 0) & (rows < camera.h)
        seen = np.zeros((camera.h, camera.w), dtype=bool)
        seen[rows[inside], columns[inside]] = True
        nearest = -camera.to_camera(self._points)[:, 2].max()
        reach = 1 + int(np.ceil(self._edge * camera.fl_x / nearest))
        return np.flatnonzero(maximum_filter(seen, size=2 * reach + 1)).astype(np.uint32)


def _mesh(name: str, layer: Layer, flat: bool) -> mi.Mesh:
    properties = mi.Properties()
    colour = lighting.COLOUR
    if layer.picture is not None:
        values = layer.picture.colour
        if flat and layer.picture.opaque is not None:
            values = values * layer.picture.opaque[..., None]  # holes would glow too
        colour = _bitmap(layer.picture, values)
    bsdf = {"type": "diffuse", "reflectance": 0.0} if flat else lighting.material(layer.material, colour)
    if flat:
        properties["emitter"] = mi.load_dict({"type": "area", "radiance": colour})
    if layer.picture is not None and layer.picture.opaque is not None:
        bsdf = {"type": "mask", "bsdf": bsdf, "opacity": _bitmap(layer.picture, layer.picture.opaque)}
    properties["bsdf" if flat else "mesh_bsdf"] = mi.load_dict(bsdf)
    return make_mesh(name, layer.rest, layer.faces, smooth=True, attributes={"vertex_color": layer.colour},
                     uv=layer.uv, props=properties)


def _bitmap(picture: Picture, values: np.ndarray) -> dict:
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "wrap_mode": picture.wrap}
