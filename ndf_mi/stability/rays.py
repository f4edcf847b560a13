"""Rays that see nothing, hardly anything, or are broken; images of a pixel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.model import PosedModel
from ndf_mi.render.image import ImageRenderer
from ndf_mi.render.quadrature import Radiance, quadrature
from ndf_mi.render.sampling import box_interval
from ndf_mi.stability.ball import GREY, Ridge, ridge
from ndf_mi.stability.case import Measured, case, error
from ndf_mi.stability.march import interval, linear, march

WHITE = "1: full opacity, white"


def bundle(origin: np.ndarray, direction: np.ndarray) -> mi.Ray3f:
    """Rays from (N, 3) origins in (N, 3) directions."""
    o, d = (np.ascontiguousarray(array.T, np.float32) for array in (origin, direction))
    return mi.Ray3f(mi.Point3f(o), mi.Vector3f(d))


def attached(ball: Ridge) -> tuple[PosedModel, mi.Float]:
    """The ball's field, and its weights, with gradients enabled."""
    weights = mi.Float(dr.detach(ball.run.parameters.weights))
    dr.enable_grad(weights)
    ball.run.parameters = ball.run.parameters.replace(weights=weights)
    return ball.run.posed(0), weights


def nothing(seen: Radiance, weights: mi.Float) -> tuple[float, float]:
    """Errors of what should be nothing, and of gradients that should be 0."""
    dr.backward(dr.sum(seen.colour.x + seen.opacity + seen.depth))
    primal = max(error(value.numpy(), np.zeros(dr.width(value))) for value in (*seen.colour, seen.opacity, seen.depth))
    return primal, error(dr.grad(weights).numpy(), np.zeros(dr.width(weights)))


@case("an empty band: rays through the body's box and cells, but not through the band", "1 to 10,000 rays", primal=0.0, gradient=0.0)
def empty_band() -> Iterator[Measured]:
    """Through the hollow in the body, and through the corners of its box."""
    with ridge() as ball:
        for count in (1, 10_000):
            model, weights = attached(ball)
            rng = np.random.default_rng(count)
            hollow = rng.normal(0, 0.03, (count, 3))
            corner = np.array([0.36, 0.36, -2.0]) + rng.uniform(-0.005, 0.005, (count, 3))
            for name, origin in (("hollow", hollow), ("corner", corner)):
                ray = bundle(origin, np.tile([0.0, 0.0, 1.0], (count, 1)))
                ray.maxt = mi.Float(0.1 if name == "hollow" else 10.0)
                yield Measured(f"{name}, {count} rays", *nothing(quadrature(model, ray, 32, geometry=True), weights))


@case("all rays missing the body's box", "1 to 10,000 rays, images of 1 to 64 × 64 pixels", primal=0.0, gradient=0.0)
def all_rays_missing() -> Iterator[Measured]:
    """Past it, and away from it; an image of nothing is its background."""
    with ridge() as ball:
        for count in (1, 10_000):
            model, weights = attached(ball)
            origin = np.tile([0.0, 0.0, 3.0], (count, 1))
            for direction in ([0.0, 0.0, 1.0], [0.0, 1.0, 0.0]):
                ray = bundle(origin, np.tile(direction, (count, 1)))
                yield Measured(f"{count} rays", *nothing(quadrature(model, ray, 32, geometry=True), weights))
        for size in (1, 2, 64):
            image = ImageRenderer(32)(ball.run.posed(0), Window(size, size, (0.0, 0.0, 3.0), 1.0), geometry=True)
            arrays = (image.linear, image.opacity, image.depth, image.u, image.normal)
            yield Measured(f"{size} × {size} pixels", max(error(a, np.zeros(a.shape)) for a in arrays if a is not None))


@dataclass
class Window:
    """A camera at a place that looks along z, or against it where `facing` is −1, through a window of half a metre a metre away."""

    w: int
    h: int
    place: tuple[float, float, float]
    facing: float = -1.0

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(N, 3) unit directions through pixel coordinates."""
        d = np.stack([0.5 * (x / self.w - 0.5), 0.5 * (y / self.h - 0.5), np.full(x.shape, self.facing)], -1)
        return d / np.linalg.norm(d, axis=-1, keepdims=True)

    def rays(self, pixels: mi.Point2f) -> mi.Ray3f:
        """The rays through pixel coordinates."""
        return bundle(np.tile(self.place, (dr.width(pixels), 1)), self.directions(*pixels.numpy().astype(np.float64)))


@case("images of one pixel, of one row and of one column; rays of one sample", "1 to 4096 samples",
      relative_to=WHITE + "; the gradient of one pixel to itself")
def one_pixel() -> Iterator[Measured]:
    """Looked at whole and in rounds, front to back; differentiated whole."""
    with ridge() as ball:
        for w, h in ((1, 1), (5, 1), (1, 5)):
            for samples in (1, 7, 64, 4096) if w == h else (64,):
                camera = Window(w, h, (0.02, 0.03, 1.2))
                y, x = (v.ravel() + 0.5 for v in np.mgrid[:h, :w])
                direction = camera.directions(x, y)
                truth = march(ball, np.tile(np.array(camera.place, np.float32), (w * h, 1)), direction.astype(np.float32), samples)
                image = ImageRenderer(samples, cutoff=0.0)(ball.run.posed(0), camera)
                gradient = None
                if w == h:
                    model, weights = attached(ball)
                    seen = quadrature(model, camera.rays(mi.Point2f(mi.Float(x), mi.Float(y))), samples)
                    dr.backward(seen.colour.x + seen.opacity)
                    grad = dr.grad(weights).numpy()
                    gradient = error(grad[ball.peak], truth.slope[0] * (1 + linear(GREY))) if np.isfinite(grad).all() else np.inf
                yield Measured(f"{w} × {h}, {samples} samples", max(
                    error(image.opacity.ravel(), truth.opacity, 1.0), error(image.depth.ravel(), truth.depth, 1.0),
                    error(image.linear[..., 0].ravel(), truth.opacity * linear(GREY), 1.0)), gradient)


@case("bodies of any size by quadrature", "1 mm to 1 km, at the origin", relative_to=WHITE + ", and a ray's largest gradient")
def bodies_by_quadrature() -> Iterator[Measured]:
    """Rays from all around."""
    for decade in range(-3, 4):
        size = 10.0**decade
        yield Measured(f"{size:g} m", *_around(size, 0.0, 1.0))


@case("bodies far from the origin by quadrature", "1 mm at 1, 1e3 and 1e6 m, 1 m at 1e3 and 1e6 m, 1 km at 1e6 m",
      primal=40.0, gradient=40.0, relative_to="float32's step at that place over the body's size, times white or a ray's largest gradient")
def bodies_far_away() -> Iterator[Measured]:
    """The same. A step in place changes the density's logarithm by 12 / 0.13 of its length over the size, and an opacity by at most 1/e
    of that: 34 steps, and the roundings of what is near as well. Where a step is a tenth of the size, that promises no more than finite."""
    for size, away in ((1e-3, 1.0), (1e-3, 1e3), (1e-3, 1e6), (1.0, 1e3), (1.0, 1e6), (1e3, 1e6)):
        yield Measured(f"{size:g} m at {away:g} m", *_around(size, away, float(np.spacing(np.float32(away))) / size))


def _around(size: float, away: float, scale: float) -> tuple[float, float]:
    """Errors of opacity and colour, and of the gradient, of rays from all around a ball, relative to `scale` of white."""
    rng = np.random.default_rng(12)
    way = rng.normal(size=(60, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    aside = np.cross(way, rng.normal(size=(60, 3)))
    aside *= rng.uniform(0, 0.4, (60, 1)) / np.linalg.norm(aside, axis=1, keepdims=True)
    place = away * np.array([0.6, -0.8, 0.0])
    with ridge((place[0], place[1], place[2]), size) as ball:
        origin = (place + size * (aside - 1.5 * way)).astype(np.float32)
        model, weights = attached(ball)
        seen = quadrature(model, bundle(origin, way), 64)
        dr.backward(dr.sum(seen.colour.x + seen.opacity))
        truth = march(ball, origin, way.astype(np.float32), 64)
        grad = dr.grad(weights).numpy()
        largest = max(np.abs(truth.slope).sum() * (1 + linear(GREY)), 1e-12)
        return (max(error(seen.opacity.numpy(), truth.opacity, scale), error(seen.colour.x.numpy(), truth.opacity * linear(GREY), scale)),
                error(grad[ball.peak], truth.slope.sum() * (1 + linear(GREY)), scale * largest) if np.isfinite(grad).all() else np.inf)


@case("one ray of many with NaN or infinity in origin, direction or end", "each component in turn",
      relative_to=WHITE + "; gradients to the largest")
def a_nan_in_one_lane() -> Iterator[Measured]:
    """The broken ray sees nothing; the others, and the weights' gradient, are as without it."""
    with ridge() as ball:
        rng = np.random.default_rng(8)
        origin = np.concatenate([rng.uniform(-0.3, 0.3, (40, 2)), np.full((40, 1), 1.2)], 1).astype(np.float32)
        direction = np.tile(np.array([0, 0, -1], np.float32), (40, 1))
        truth = march(ball, origin, direction, 64)
        whole = np.arange(40) != 17
        expected = (truth.slope * (1 + linear(GREY)))[whole].sum()
        for name, value in (("NaN", np.nan), ("infinity", np.inf), ("−infinity", -np.inf)):
            for part in range(7):
                o, d = origin.copy(), direction.copy()
                maxt = np.full(40, 1e3, np.float32)
                if part == 6:
                    maxt[17] = value if value < 0 or np.isnan(value) else -value
                else:
                    (o if part < 3 else d)[17, part % 3] = value
                ray = bundle(o, d)
                ray.maxt = mi.Float(maxt)
                model, weights = attached(ball)
                seen = quadrature(model, ray, 64)
                dr.backward(dr.sum(seen.colour.x + seen.opacity))
                opacity, grad = seen.opacity.numpy(), dr.grad(weights).numpy()
                gradient = error(grad[ball.peak], expected) if np.isfinite(grad).all() else np.inf
                yield Measured(f"{name} in {('o.x', 'o.y', 'o.z', 'd.x', 'd.y', 'd.z', 'the end')[part]}", max(
                    error(opacity[whole], truth.opacity[whole], 1.0), error(opacity[~whole], [0.0], 1.0)), gradient)


@case("rays along faces, edges and diagonals of the box, from within, and from its corners", "directions of 1e-30 to 1 off the axes",
      gradient=None, relative_to="the box's size and the ray's way to it")
def along_the_box() -> Iterator[Measured]:
    """Where the interval begins and ends; on the very face of the box a ray may count as in or out."""
    low, high = np.array([-0.5, -0.25, 1.0]), np.array([0.5, 0.75, 1.5])
    box = mi.BoundingBox3f(mi.Point3f(-0.5, -0.25, 1.0), mi.Point3f(0.5, 0.75, 1.5))
    starts = [[0, 0, 0], [0.5, 0, 0], [-0.5, 0.75, 0], [0, 0, 1.25], [0.5, 0.75, 1.5], [-0.5, -0.25, 1.0], [0, 0, 1.0], [7, 3, -9]]
    for off in (0.0, *(10.0**-k for k in range(0, 31, 3))):
        origin = np.repeat(np.array(starts), 6, 0).astype(np.float32)
        ways = np.array([[0, 0, 1], [off, 0, 1], [off, -off, 1], [0, 0, -1], [1, off, 0], [-off, off, off or 1.0]])
        direction = np.tile(ways / np.linalg.norm(ways, axis=1, keepdims=True), (len(starts), 1)).astype(np.float32)
        hit, near, far = box_interval(box, bundle(origin, direction))
        first, last = interval(origin.astype(np.float64), direction.astype(np.float64), low, high)
        touching = ((np.abs(origin - low) < 1e-6) | (np.abs(origin - high) < 1e-6)).any(1)
        both = (hit.numpy() & (last > first)) | ~touching
        finite = np.isfinite(near.numpy()).all() and np.isfinite(far.numpy()).all()
        size = 1 + np.linalg.norm(origin, axis=1)[both]
        yield Measured(f"{off:g}", max(error(near.numpy()[both], first[both], size), error(far.numpy()[both], last[both], size))
                       if finite else np.inf)
