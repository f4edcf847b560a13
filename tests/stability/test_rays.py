"""Rays that see nothing, almost nothing, or are not numbers; images of one pixel; bodies of any size."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.render.image import ImageRenderer
from ndf_mi.render.quadrature import Radiance, quadrature
from ndf_mi.render.sampling import box_interval
from ndf_mi.stability.ball import GREY_LINEAR, Ridge, ridge
from ndf_mi.stability.case import Check, case, decades, error
from ndf_mi.stability.march import interval, march

WHITE = "1: full opacity, white"


def bundle(origin: np.ndarray, direction: np.ndarray) -> mi.Ray3f:
    """Rays from (N, 3) origins in (N, 3) directions."""
    o, d = (np.ascontiguousarray(array.T, np.float32) for array in (origin, direction))
    return mi.Ray3f(mi.Point3f(o), mi.Vector3f(d))


def see(ball: Ridge, ray: mi.Ray3f, samples: int, geometry: bool = False) -> tuple[Radiance, np.ndarray]:
    """What rays see, and the derivatives of colour + opacity, with `geometry` + depth, in the weights."""
    weights = mi.Float(dr.detach(ball.run.parameters.weights))
    dr.enable_grad(weights)
    ball.run.parameters = ball.run.parameters.replace(weights=weights)
    seen = quadrature(ball.run.posed(0), ray, samples, geometry=geometry)
    dr.backward(dr.sum(seen.colour.x + seen.opacity + (seen.depth if geometry else 0)))
    return seen, dr.grad(weights).numpy()


def peak_error(ball: Ridge, gradient: np.ndarray, expected: float, scale: float | None = None) -> float:
    """Error of the derivative in the density's PEAK; infinite if any derivative is not finite."""
    return error(gradient[ball.peak], expected, scale) if np.isfinite(gradient).all() else np.inf


def check_nothing(check: Check, ball: Ridge, ray: mi.Ray3f, at: str = "") -> None:
    """Colours, opacities, depths and gradients are exactly zero."""
    seen, gradient = see(ball, ray, 32, geometry=True)
    values = np.stack([value.numpy() for value in (*seen.colour, seen.opacity, seen.depth)])
    check(error(values, np.zeros(values.shape)), error(gradient, np.zeros(gradient.shape)), at)


@case(
    "an empty band: rays through the body's box and cells, but not through the band", "1 to 10,000 rays",
    primal=0.0, gradient=0.0)
@pytest.mark.parametrize("count", [1, 10_000], ids="{} rays".format)
@pytest.mark.parametrize("part", ["hollow", "corner"])
def test_empty_band(check: Check, ball: Ridge, part: str, count: int) -> None:
    """Through the hollow inside the body, and through the corners of its box."""
    rng = np.random.default_rng(count)
    if part == "hollow":
        origin, end = rng.normal(0, 0.03, (count, 3)), 0.1
    else:
        origin, end = np.array([0.36, 0.36, -2.0]) + rng.uniform(-0.005, 0.005, (count, 3)), 10.0
    ray = bundle(origin, np.tile([0.0, 0.0, 1.0], (count, 1)))
    ray.maxt = mi.Float(end)
    check_nothing(check, ball, ray)


@case(
    "all rays missing the body's box", "1 to 10,000 rays, images of 1 to 64 × 64 pixels", primal=0.0,
    gradient=0.0)
@pytest.mark.parametrize("count", [1, 10_000], ids="{} rays".format)
@pytest.mark.parametrize("direction", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0)], ids=["away from it", "past it"])
def test_all_rays_missing(
    check: Check, ball: Ridge, direction: tuple[float, float, float], count: int) -> None:
    check_nothing(check, ball, bundle(np.tile([0.0, 0.0, 3.0], (count, 1)), np.tile(direction, (count, 1))))
    for size in (1, 2, 64) if count > 1 else ():
        image = ImageRenderer(32)(ball.run.posed(0), Window(size, size, (0.0, 0.0, 3.0), 1.0), geometry=True)
        arrays = (image.linear, image.opacity, image.depth, image.u, image.normal)
        check(
            max(error(a, np.zeros(a.shape)) for a in arrays if a is not None), None, f"{size} × {size} pixels"
        )


@dataclass
class Window:
    """A camera that looks along z times `facing` through a window half a metre wide, one metre away."""

    w: int
    h: int
    place: tuple[float, float, float]
    facing: float = -1.0

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(N, 3) unit directions through pixel coordinates."""
        d = np.stack([0.5 * (x / self.w - 0.5), 0.5 * (y / self.h - 0.5), np.full(x.shape, self.facing)], -1)
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def rays(self, pixels: mi.Point2f) -> mi.Ray3f:
        """Rays through pixel coordinates."""
        return bundle(
            np.tile(self.place, (dr.width(pixels), 1)), self.directions(*pixels.numpy().astype(np.float64)))


@case("images of one pixel, of one row and of one column; rays of one sample", "1 to 4096 samples",
      relative_to=WHITE + "; the gradient of one pixel to itself")
@pytest.mark.parametrize(
    ("w", "h", "samples"), [(1, 1, 1), (1, 1, 7), (1, 1, 64), (1, 1, 4096), (5, 1, 64), (1, 5, 64)])
def test_one_pixel(check: Check, ball: Ridge, w: int, h: int, samples: int) -> None:
    """Rendered in rounds, front to back; differentiated as a whole."""
    camera = Window(w, h, (0.02, 0.03, 1.2))
    y, x = (v.ravel() + 0.5 for v in np.mgrid[:h, :w])
    direction = camera.directions(x, y)
    truth = march(
        ball, np.tile(np.array(camera.place, np.float32), (w * h, 1)), direction.astype(np.float32), samples)
    image = ImageRenderer(samples, cutoff=0.0)(ball.run.posed(0), camera)
    gradient = None
    if w == h:
        _, found = see(ball, camera.rays(mi.Point2f(mi.Float(x), mi.Float(y))), samples)
        gradient = peak_error(ball, found, truth.slope[0] * (1 + GREY_LINEAR))
    check(max(error(image.opacity.ravel(), truth.opacity, 1.0), error(image.depth.ravel(), truth.depth, 1.0),
              error(image.linear[..., 0].ravel(), truth.opacity * GREY_LINEAR, 1.0)), gradient)


@case(
    "bodies of any size by quadrature", "1 mm to 1 km, at the origin",
    relative_to=WHITE + ", and a ray's largest gradient")
@pytest.mark.parametrize("size", decades(-3, 3), ids="{:g} m".format)
def test_bodies_by_quadrature(check: Check, size: float) -> None:
    check(*errors_around(size, 0.0, 1.0))


@case(
    "bodies far from the origin by quadrature",
    "1 mm at 1, 1e3 and 1e6 m, 1 m at 1e3 and 1e6 m, 1 km at 1e6 m", primal=40.0, gradient=40.0,
    relative_to="float32's spacing at that place over the body's size, times white or a ray's largest "
    "gradient")
@pytest.mark.parametrize(
    ("size", "away"), [(1e-3, 1.0), (1e-3, 1e3), (1e-3, 1e6), (1.0, 1e3), (1.0, 1e6), (1e3, 1e6)],
    ids="{:g} m".format)
def test_bodies_far_away(check: Check, size: float, away: float) -> None:
    """Moving a point by one spacing changes the density's logarithm by 12 / 0.13 of spacing over size, and an
    opacity by at most 1/e of that: 34 spacings, plus the rounding errors of bodies at the origin. Where the
    spacing is a tenth of the size, this only means finite."""
    check(*errors_around(size, away, float(np.spacing(np.float32(away))) / size))


def errors_around(size: float, away: float, scale: float) -> tuple[float, float]:
    """Errors of colour and opacity, and of the gradient, of rays from all around, relative to `scale`."""
    rng = np.random.default_rng(12)
    way = rng.normal(size=(60, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    aside = np.cross(way, rng.normal(size=(60, 3)))
    aside *= rng.uniform(0, 0.4, (60, 1)) / np.linalg.norm(aside, axis=1, keepdims=True)
    place = away * np.array([0.6, -0.8, 0.0])
    with ridge((place[0], place[1], place[2]), size) as ball:
        origin = (place + size * (aside - 1.5 * way)).astype(np.float32)
        seen, gradient = see(ball, bundle(origin, way), 64)
        truth = march(ball, origin, way.astype(np.float32), 64)
        largest = max(np.abs(truth.slope).sum() * (1 + GREY_LINEAR), 1e-12)
        primal = max(
            error(seen.opacity.numpy(), truth.opacity, scale),
            error(seen.colour.x.numpy(), truth.opacity * GREY_LINEAR, scale))
        return primal, peak_error(ball, gradient, truth.slope.sum() * (1 + GREY_LINEAR), scale * largest)


@case("one ray of many with NaN or infinity in origin, direction or end", "each component in turn",
      relative_to=WHITE + "; gradients to the largest")
@pytest.mark.parametrize("part", ["o.x", "o.y", "o.z", "d.x", "d.y", "d.z", "the end"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_nan_in_one_lane(check: Check, ball: Ridge, value: float, part: str) -> None:
    """The broken ray sees nothing; the others, and the gradient of the weights, do not change."""
    rng = np.random.default_rng(8)
    origin = np.concatenate([rng.uniform(-0.3, 0.3, (40, 2)), np.full((40, 1), 1.2)], 1).astype(np.float32)
    direction = np.tile(np.array([0, 0, -1], np.float32), (40, 1))
    truth = march(ball, origin, direction, 64)
    broken = np.arange(40) == 17
    end = np.full(40, 1e3, np.float32)
    if part == "the end":
        end[broken] = -abs(value)
    else:
        (origin if part[0] == "o" else direction)[broken, "xyz".index(part[-1])] = value
    ray = bundle(origin, direction)
    ray.maxt = mi.Float(end)
    seen, gradient = see(ball, ray, 64)
    opacity = np.where(broken, 0.0, truth.opacity)
    check(
        error(seen.opacity.numpy(), opacity, 1.0),
        peak_error(ball, gradient, (truth.slope * (1 + GREY_LINEAR))[~broken].sum()))


@case(
    "rays along faces, edges and diagonals of the box, from within, and from its corners",
    "directions of 1e-30 to 1 off the axes", gradient=None,
    relative_to="the box's size and the ray's distance from it")
@pytest.mark.parametrize("off", [0.0, *decades(0, -30, -3)], ids="{:g}".format)
def test_along_the_box(check: Check, off: float) -> None:
    """Where the interval begins and ends. A ray exactly on a face may count as inside or outside."""
    low, high = np.array([-0.5, -0.25, 1.0]), np.array([0.5, 0.75, 1.5])
    box = mi.BoundingBox3f(mi.Point3f(low.tolist()), mi.Point3f(high.tolist()))
    starts = [
        [0, 0, 0], [0.5, 0, 0], [-0.5, 0.75, 0], [0, 0, 1.25], [0.5, 0.75, 1.5], [-0.5, -0.25, 1.0],
        [0, 0, 1.0], [7, 3, -9]]
    ways = np.array(
        [[0, 0, 1], [off, 0, 1], [off, -off, 1], [0, 0, -1], [1, off, 0], [-off, off, off or 1.0]])
    origin = np.repeat(np.array(starts), len(ways), 0).astype(np.float32)
    direction = np.tile(ways / np.linalg.norm(ways, axis=1, keepdims=True), (len(starts), 1)).astype(
        np.float32)
    hit, near, far = (value.numpy() for value in box_interval(box, bundle(origin, direction)))
    first, last = interval(origin.astype(np.float64), direction.astype(np.float64), low, high)
    touching = ((np.abs(origin - low) < 1e-6) | (np.abs(origin - high) < 1e-6)).any(1)
    both = (hit & (last > first)) | ~touching
    finite = np.isfinite(near).all() and np.isfinite(far).all()
    size = 1 + np.linalg.norm(origin, axis=1)[both]
    check(max(error(near[both], first[both], size), error(far[both], last[both], size)) if finite else np.inf)
