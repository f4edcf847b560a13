"""Plugins, through scenes: cameras in, on and along the performer; shells around bodies of any size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.projection import Surface
from ndf_mi.render.replay import Replay, repeated
from ndf_mi.render.shell import band_points, band_shell
from ndf_mi.stability.ball import GREY, RADIUS, Ridge, charts, icosphere, looking, ridge
from ndf_mi.stability.case import Measured, case, error
from ndf_mi.stability.closest import inside
from ndf_mi.stability.march import linear, march

SAMPLES = 64

PATH_TRACED = ("in the band, looking along it", "in the body's part of the band", "deep in the body",
               "touching a triangle, looking along it", "grazing the shell")


def cameras(ball: Ridge) -> dict[str, Camera]:
    """By what is extreme about them; all about one triangle of the ball."""
    corners = ball.vertices[ball.faces[40]].astype(np.float64)
    centre = corners.mean(0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    along = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
    return {
        "outside": looking(1.5 * normal, -normal),
        "in the band, looking along it": looking(centre + 0.03 * normal, along),
        "in the band, looking in": looking(centre + 0.05 * normal, -normal),
        "in the body's part of the band": looking(centre - 0.02 * normal, along + normal),
        "deep in the body": looking(0.02 * normal, along),
        "touching a triangle, looking along it": looking(centre, along),
        "touching a triangle, looking in": looking(centre, -normal),
        "touching a vertex": looking(corners[0], normal + along),
        "grazing the shell": looking((RADIUS + 0.08) * normal - 1.5 * along, along, focal=30.0),
        "grazing the surface": looking(RADIUS * normal - 1.5 * along, along, focal=30.0),
    }


def scene_of(ball: Ridge, integrator: dict[str, Any], camera: Camera, within: bool = False, **more: Any) -> mi.Scene:
    """The ball's performer in its shell, before a camera, which is `within` the medium."""
    ref = {"type": "ref", "id": "medium"}
    sensor = camera.sensor()
    return mi.load_dict({
        "type": "scene", "integrator": integrator, "medium": {"type": "ndf", "run": str(ball.run.path)},
        "performer": {"type": "ndf_shell", "cell": 0.03, "interior": ref},
        "sensor": {**sensor, "medium": ref} if within else sensor, **more})


def pixel_rays(scene: mi.Scene, camera: Camera) -> mi.Ray3f:
    """The sensor's own rays through the pixels' centres; from where they begin, past the near clip."""
    y, x = (v.ravel() + 0.5 for v in np.mgrid[: camera.h, : camera.w])
    place = mi.Point2f(mi.Float(x / camera.w), mi.Float(y / camera.h))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    dr.eval(ray)
    return ray


@case("cameras in the band, in the body, touching a triangle, grazing shell and surface: ndf_quadrature in a scene",
      "ten cameras of 8 × 8 pixels", relative_to="1: full opacity, white; gradients to a ray's largest")
def cameras_by_quadrature() -> Iterator[Measured]:
    """The integrator's colours and opacities along the sensor's rays, and the derivative of their sum in one of the medium's weights."""
    with ridge() as ball:
        for name, camera in cameras(ball).items():
            scene = scene_of(ball, {"type": "ndf_quadrature", "samples": SAMPLES, "aovs": "opacity"}, camera)
            parameters = mi.traverse(scene)
            key = next(k for k in parameters.keys() if k.endswith(".weights"))  # noqa: SIM118 - not a dict
            dr.enable_grad(parameters[key])
            parameters.update()
            ray = pixel_rays(scene, camera)
            origin, direction = (v.numpy().T for v in (ray.o + dr.zeros(mi.Point3f, dr.width(ray.d)), ray.d))
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(0, dr.width(ray.d))
            colour, _, aovs, _ = scene.integrator().sample(dr.ADMode.Primal, scene, sampler, ray)
            dr.backward(dr.sum(colour.x + aovs[0]))
            truth = march(ball, origin, direction, SAMPLES)
            grey = linear(GREY)
            slopes = dr.grad(parameters[key]).numpy()
            expected = truth.slope.sum() * (1 + grey)
            gradient = error(slopes[ball.peak], expected, np.abs(truth.slope).sum() + np.abs(truth.slope).max())
            yield Measured(name, max(error(colour.x.numpy(), grey * truth.opacity, 1.0), error(aovs[0].numpy(), truth.opacity, 1.0)),
                           gradient if np.isfinite(slopes).all() else np.inf)


@case("cameras in, on and along the performer under volpath, in the medium that they are in",
      "five of the cameras, 8192 paths each", primal=5.0, gradient=None,
      relative_to="the standard error of the mean over the image", long=True)
def cameras_by_path_tracing() -> Iterator[Measured]:
    """Mean transmittance towards a sky of 1, of a medium that scatters nothing, against marches through each pixel."""
    with ridge(srgb=1e-6) as ball:
        every = cameras(ball)
        for name in PATH_TRACED:
            camera = every[name]
            within = not name.startswith(("deep", "grazing"))
            scene = scene_of(ball, {"type": "volpath", "max_depth": 4, "rr_depth": 100}, camera, within, sky={"type": "constant"})
            images = np.stack([mi.render(scene, spp=64, seed=seed).numpy()[..., 0] for seed in range(2)]).astype(np.float64)
            fine = camera.scaled(4 * camera.w, 4 * camera.h)
            ray = pixel_rays(scene, fine)
            origin, direction = (v.numpy().T for v in (ray.o + dr.zeros(mi.Point3f, dr.width(ray.d)), ray.d))
            clear = 1 - march(ball, origin, direction, 48).opacity
            # Of a path's outcome, 0 or 1, by the share of those that get through.
            noise = np.sqrt(np.mean(clear * (1 - clear)) / (images.size * 64))
            yield Measured(name, error(images.mean(), clear.mean(), max(noise, 1e-5)) if np.isfinite(images).all() else np.inf)


@case("gradients of the same medium by prbvolpath, in the networks' weight that its density peaks by",
      "three cameras outside of the medium, 16 × 512 paths each", primal=5.0, gradient=5.0,
      relative_to="the standard error of the mean over the image", long=True)
def gradients_by_path_tracing() -> Iterator[Measured]:
    """Mean transmittance and its derivative, against those of marches through each ray; `prbvolpath` begins outside of media."""
    with ridge(srgb=1e-6) as ball:
        every = cameras(ball)
        for name in ("outside", "deep in the body", "grazing the surface"):
            scene = scene_of(ball, {"type": "prbvolpath"}, every[name])
            parameters = mi.traverse(scene)
            key = next(k for k in parameters.keys() if k.endswith(".weights"))  # noqa: SIM118 - not a dict
            dr.enable_grad(parameters[key])
            parameters.update()
            # A path that ends in the dark has met something: only those that get through see the background.
            replay = Replay(scene, mi.load_dict({"type": "prbvolpath", "max_depth": 4, "hide_emitters": True}), mi.Color3f(1.0))
            ray = pixel_rays(scene, every[name].scaled(16, 16))
            count = dr.width(ray.d)
            rays = repeated(mi.Ray3f(ray.o + dr.zeros(mi.Point3f, count), ray.d), 2)
            through, slopes = [], []
            for seed in range(16):
                radiance = replay.radiance(rays, seed)
                through.append(float(dr.mean(radiance.x)[0]))
                dr.set_grad(parameters[key], 0)
                replay.backward(rays, seed, radiance, mi.Color3f(1 / (2 * count), 0, 0))
                slopes.append(float(dr.grad(parameters[key])[ball.peak]))
            origin, direction = (v.numpy().T for v in (ray.o + dr.zeros(mi.Point3f, count), ray.d))
            truth = march(ball, origin, direction, 48)
            noise, slope_noise = (max(float(np.std(v, ddof=1)) / 4, 1e-5) for v in (through, slopes))
            yield Measured(name, error(np.mean(through), (1 - truth.opacity).mean(), noise),
                           error(np.mean(slopes), -truth.slope.mean(), slope_noise))


@case("shells contain the whole band",
      "bodies of 1 mm to 1 km at the origin, of 0.1 m on 1e3 m and of 100 m on 1e6 m away; and cells too small for them",
      primal=0.0, gradient=None, relative_to="no point outside")
def shells() -> Iterator[Measured]:
    """Random points of the band against the solid angle of the shell; a grid that would not fit memory is refused."""
    vertices, faces = icosphere(1, 1.0)
    uv, uv_faces = charts(len(faces))
    for decade in range(-3, 4):
        size = 10.0**decade
        for place in (0.0, 1e3, 1e6):
            if np.spacing(np.float32(place)) > 1e-3 * size:
                continue
            moved = (size * vertices.astype(np.float64) + place * np.array([0.6, -0.8, 0.0])).astype(np.float32)
            surface = Surface(faces, uv, uv_faces, moved)
            shell, triangles = band_shell(surface, mi.Float(moved.ravel()), 0.2 * size, 0.15 * size, 0.1 * size)
            points = band_points(surface, moved, 0.2 * size, 0.1 * size, 400)
            missed = 1 - inside(points, shell, triangles.astype(np.int64)).mean()
            yield Measured(f"{size:g} m at {place:g} m", float(missed))
    kilometre = (1e3 * vertices).astype(np.float32)
    try:
        band_shell(Surface(faces, uv, uv_faces, kilometre), mi.Float(kilometre.ravel()), 0.08)
        refused = False
    except InputError:
        refused = True
    yield Measured("1000 m in cells of 0.0125 m", 0.0 if refused else np.inf)
