"""Plugins in scenes: cameras in, on and along the performer; shells around bodies of any size."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.projection import Surface
from ndf_mi.render.replay import Replay, repeated
from ndf_mi.render.shell import band_points, band_shell
from ndf_mi.stability.ball import GREY_LINEAR, RADIUS, Ridge, charts, icosphere, looking, ridge
from ndf_mi.stability.case import Check, case, decades, error
from ndf_mi.stability.closest import inside
from ndf_mi.stability.march import Seen, march

STANDARD_ERROR = "the standard error of the mean over the image"

VIEWS = (
    "outside", "in the band, looking along it", "in the band, looking in", "in the body's part of the band",
    "deep in the body", "touching a triangle, looking along it", "touching a triangle, looking in",
    "touching a vertex", "grazing the shell", "grazing the surface")


def camera_of(ball: Ridge, view: str) -> Camera:
    """One of VIEWS, all near one triangle of the ball."""
    corners = ball.vertices[ball.faces[40]].astype(np.float64)
    centre = corners.mean(0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    along = (corners[1] - corners[0]) / np.linalg.norm(corners[1] - corners[0])
    return dict(zip(VIEWS, (
        looking(1.5 * normal, -normal), looking(centre + 0.03 * normal, along),
        looking(centre + 0.05 * normal, -normal), looking(centre - 0.02 * normal, along + normal),
        looking(0.02 * normal, along), looking(centre, along), looking(centre, -normal),
        looking(corners[0], normal + along),
        looking((RADIUS + 0.08) * normal - 1.5 * along, along, focal=30.0),
        looking(RADIUS * normal - 1.5 * along, along, focal=30.0)), strict=True))[view]


def scene_of(
    ball: Ridge, integrator: dict[str, Any], camera: Camera, within: bool = False, **more: Any) -> mi.Scene:
    """The ball's medium in its shell, seen by a camera, which is `within` the medium or not."""
    ref = {"type": "ref", "id": "medium"}
    return mi.load_dict({
        "type": "scene", "integrator": integrator, "medium": {"type": "ndf", "run": str(ball.run.path)},
        "performer": {"type": "ndf_shell", "cell": 0.03, "interior": ref},
        "sensor": camera.sensor() | ({"medium": ref} if within else {}), **more})


def attached_weights(scene: mi.Scene) -> mi.Float:
    """The weights of the scene's medium, with gradients enabled."""
    parameters = mi.traverse(scene)
    key = next(k for k in parameters.keys() if k.endswith(".weights"))  # noqa: SIM118 - not a dict
    dr.enable_grad(parameters[key])
    parameters.update()
    return parameters[key]


def pixel_rays(scene: mi.Scene, camera: Camera) -> mi.Ray3f:
    """The sensor's own rays through the pixels' centres, which begin behind the near clip."""
    y, x = (v.ravel() + 0.5 for v in np.mgrid[: camera.h, : camera.w])
    place = mi.Point2f(mi.Float(x / camera.w), mi.Float(y / camera.h))
    ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    ray.o = ray.o + dr.zeros(mi.Point3f, dr.width(ray.d))
    dr.eval(ray)
    return ray


def march_along(ball: Ridge, ray: mi.Ray3f, samples: int) -> Seen:
    """The reference along rays."""
    return march(ball, ray.o.numpy().T, ray.d.numpy().T, samples)


@case(
    "cameras in the band, in the body, touching a triangle, grazing shell and surface: ndf_quadrature "
    "in a scene", "ten cameras of 8 × 8 pixels",
    relative_to="1: full opacity, white; gradients to a ray's largest")
@pytest.mark.parametrize("view", VIEWS)
def test_cameras_by_quadrature(check: Check, ball: Ridge, view: str) -> None:
    """The integrator's colours and opacities along the sensor's rays, and the derivative of their sum in one
    of the medium's weights."""
    camera = camera_of(ball, view)
    scene = scene_of(ball, {"type": "ndf_quadrature", "samples": 64, "aovs": "opacity"}, camera)
    weights = attached_weights(scene)
    ray = pixel_rays(scene, camera)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, dr.width(ray.d))
    colour, _, aovs, _ = scene.integrator().sample(dr.ADMode.Primal, scene, sampler, ray)
    dr.backward(dr.sum(colour.x + aovs[0]))
    truth = march_along(ball, ray, 64)
    slopes = dr.grad(weights).numpy()
    assert np.isfinite(slopes).all()
    check(
        max(
            error(colour.x.numpy(), GREY_LINEAR * truth.opacity, 1.0),
            error(aovs[0].numpy(), truth.opacity, 1.0)),
        error(
            slopes[ball.peak], truth.slope.sum() * (1 + GREY_LINEAR),
            np.abs(truth.slope).sum() + np.abs(truth.slope).max()),
    )


@pytest.fixture(scope="module")
def dark_ball() -> Iterator[Ridge]:
    """A ridge that scatters nothing."""
    with ridge(srgb=1e-6) as found:
        yield found


@pytest.mark.long
@case(
    "cameras in, on and along the performer under volpath, in the medium that they are in",
    "five of the cameras, 8192 paths each", primal=5.0, gradient=None, relative_to=STANDARD_ERROR)
@pytest.mark.parametrize(
    "view",
    [
        "in the band, looking along it", "in the body's part of the band", "deep in the body",
        "touching a triangle, looking along it", "grazing the shell"],
)
def test_cameras_by_path_tracing(check: Check, dark_ball: Ridge, view: str) -> None:
    """Mean transmittance towards a sky of 1, against marches through each pixel."""
    camera = camera_of(dark_ball, view)
    within = not view.startswith(("deep", "grazing"))
    scene = scene_of(
        dark_ball, {"type": "volpath", "max_depth": 4, "rr_depth": 100}, camera, within,
        sky={"type": "constant"})
    images = np.stack([mi.render(scene, spp=64, seed=seed).numpy()[..., 0] for seed in range(2)]).astype(
        np.float64)
    assert np.isfinite(images).all()
    clear = (
        1 - march_along(dark_ball, pixel_rays(scene, camera.scaled(4 * camera.w, 4 * camera.h)), 48).opacity)
    # A path either gets through or not: a binomial variance.
    noise = np.sqrt(np.mean(clear * (1 - clear)) / (images.size * 64))
    check(error(images.mean(), clear.mean(), max(noise, 1e-5)))


@pytest.mark.long
@case(
    "gradients of the same medium by prbvolpath, in the weight that sets the peak of its density",
    "three cameras outside of the medium, 16 × 512 paths each", primal=5.0, gradient=5.0,
    relative_to=STANDARD_ERROR)
@pytest.mark.parametrize("view", ["outside", "deep in the body", "grazing the surface"])
def test_gradients_by_path_tracing(check: Check, dark_ball: Ridge, view: str) -> None:
    """Mean transmittance and its derivative, against marches; `prbvolpath` starts outside of media."""
    camera = camera_of(dark_ball, view)
    scene = scene_of(dark_ball, {"type": "prbvolpath"}, camera)
    weights = attached_weights(scene)
    # Paths absorbed in the medium have hit something, so with `hide_emitters` only those that get through see
    # the background.
    replay = Replay(
        scene, mi.load_dict({"type": "prbvolpath", "max_depth": 4, "hide_emitters": True}), mi.Color3f(1.0))
    ray = pixel_rays(scene, camera.scaled(16, 16))
    rays = repeated(mi.Ray3f(ray.o, ray.d), 2)
    through, slopes = [], []
    for seed in range(16):
        radiance = replay.radiance(rays, seed)
        through.append(float(dr.mean(radiance.x)[0]))
        dr.set_grad(weights, 0)
        replay.backward(rays, seed, radiance, mi.Color3f(1 / dr.width(rays.d), 0, 0))
        slopes.append(float(dr.grad(weights)[dark_ball.peak]))
    truth = march_along(dark_ball, ray, 48)
    noise, slope_noise = (max(float(np.std(v, ddof=1)) / 4, 1e-5) for v in (through, slopes))
    check(
        error(np.mean(through), (1 - truth.opacity).mean(), noise),
        error(np.mean(slopes), -truth.slope.mean(), slope_noise))


SHELLS = case(
    "shells contain the whole band",
    "bodies of 1 mm to 1 km at the origin, of 0.1 m on 1e3 m and of 100 m on 1e6 m away; and cells too small "
    "for them", primal=0.0, gradient=None, relative_to="no point outside")


@SHELLS
@pytest.mark.parametrize(
    ("size", "place"),
    [
        (size, place) for size in decades(-3, 3) for place in (0.0, 1e3, 1e6)
        if np.spacing(np.float32(place)) <= 1e-3 * size],
    ids="{:g} m".format,
)
def test_shells(check: Check, size: float, place: float) -> None:
    """Random points of the band against the solid angle of the shell."""
    vertices, faces = icosphere(1, 1.0)
    uv, uv_faces = charts(len(faces))
    moved = (size * vertices.astype(np.float64) + place * np.array([0.6, -0.8, 0.0])).astype(np.float32)
    surface = Surface(faces, uv, uv_faces, moved)
    shell, triangles = band_shell(surface, mi.Float(moved.ravel()), 0.2 * size, 0.15 * size, 0.1 * size)
    points = band_points(surface, moved, 0.2 * size, 0.1 * size, 400)
    check(float(1 - inside(points, shell, triangles.astype(np.int64)).mean()))


@SHELLS
def test_shells_of_cells_too_small(check: Check) -> None:
    """A grid that would not fit in memory is refused."""
    vertices, faces = icosphere(1, 1.0)
    kilometre = (1e3 * vertices).astype(np.float32)
    with pytest.raises(InputError):
        band_shell(Surface(faces, *charts(len(faces)), kilometre), mi.Float(kilometre.ravel()), 0.08)
    check(0.0, at="1000 m in cells of 0.0125 m")
