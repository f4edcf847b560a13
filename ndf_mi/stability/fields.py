"""The networks and what comes out of them: activations, colours, numbers beyond half precision; majorants."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.field import Field, FieldParameters, preset
from ndf_mi.field.encoding import GridEncoding
from ndf_mi.field.field import BoundField
from ndf_mi.render.image import ImageRenderer
from ndf_mi.render.nested import Majorants
from ndf_mi.render.replay import Replay
from ndf_mi.stability.ball import PEAK, looking, ridge
from ndf_mi.stability.case import Measured, case, error
from ndf_mi.stability.grid64 import Grid64
from ndf_mi.stability.network64 import Network64, decode, encode, logistic
from ndf_mi.variants import cooperative_precisions

JOINTS = 5


def slope_of(function: Callable[[mi.Float], mi.Float], at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives of a function of single numbers."""
    x = mi.Float(np.ascontiguousarray(at, np.float32))
    dr.enable_grad(x)
    value = function(x)
    dr.backward(dr.sum(value))
    return value.numpy().astype(np.float64), dr.grad(x).numpy().astype(np.float64)


@case("density from the network's output: exactly zero, just above it, up to its limit, under the majorant",
      "outputs of 0 and ±1e-38 to ±1e38")
def activation() -> Iterator[Measured]:
    """Both activations. The density never passes its limit, and the majorant stays 4 % above it."""
    bounds = {name: (field := Field(preset(name), JOINTS)).bind(dr.zeros(mi.Float, 3 * JOINTS), field.initial_parameters(1))
              for name in ("fast", "paper")}
    decades = [0.0, *(sign * 10.0**k for k in range(-38, 39, 2) for sign in (1, -1)), 3.0, 30.0, 100.0, -30.0, -80.0]
    for z in decades:
        at = (z * np.array([1.0, 0.7])).astype(np.float32)
        primal, gradient = 0.0, 0.0
        for bound in bounds.values():
            p = bound.preset
            value, slope = slope_of(bound.activation, at)
            if p.density_activation == "softplus":
                shifted = (at + np.float32(p.density_bias)).astype(np.float64)
                a, da = np.logaddexp(0, shifted), logistic(shifted)
            else:
                a, da = np.maximum(at, 0).astype(np.float64), (at > 0).astype(np.float64)
            primal = max(primal, error(value, -p.density_limit * np.expm1(-a * p.density_gain / p.density_limit)))
            # At 0 a ReLU has any derivative from 0 to 1.
            kink = (at == 0) & (p.density_activation == "relu")
            gradient = max(gradient, error(slope[~kink], (p.density_gain * da * np.exp(-a * p.density_gain / p.density_limit))[~kink]))
            if (value > p.density_limit).any() or bound.majorant < 1.04 * p.density_limit or (value < 0).any():
                primal = np.inf
        yield Measured(f"{z:g}", primal, gradient)


class Scaled:
    """A network that stays the same while its hidden values grow or shrink: a ReLU layer times s, the next by 1/s.

    Attributes:
        field: with the encoding `frequency`.
        u, d, n: (64, 3) coordinates, directions and normals.
        sigma, colour: the reference's there, over the density's limit and over white.
        slope: (64, 3) derivatives of σ / limit + r + g + b in u.
    """

    def __init__(self) -> None:
        shape = dataclasses.replace(preset("tiny"), encoding="frequency", octaves=3, deformation_scale=0.1, direction="mirrored")
        self.field = Field(shape, JOINTS)
        rng = np.random.default_rng(3)
        count = 64
        self.u = rng.uniform(0.1, 0.9, (count, 3)).astype(np.float32)
        d, n = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, count, 3)))
        self.d, self.n = d.astype(np.float32), n.astype(np.float32)
        self._pose = rng.normal(0, 0.3, 3 * JOINTS).astype(np.float32)
        self._base = self.field.initial_parameters(2).weights.numpy().copy()
        # Products start at zero, where nothing would be seen of them.
        for layer in self.field.layers.values():
            self._base[layer.offset + layer.affine : layer.offset + layer.size] = rng.normal(0, 0.1, layer.size - layer.affine)
        truth = Network64(self.field, self._base, self._pose)

        def at(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            sigma, colour = truth(u, self.d.astype(np.float64), self.n.astype(np.float64))
            return sigma / shape.density_limit, colour

        exact = self.u.astype(np.float64)
        self.sigma, self.colour = at(exact)
        ends = [[sigma + colour.sum(1) for sigma, colour in (at(exact + way * e) for way in (1e-6, -1e-6))] for e in np.eye(3)]
        self.slope = np.stack([(after - before) / 2e-6 for after, before in ends], 1)

    def bind(self, power: int) -> BoundField:
        """The field with hidden values times 2^power."""
        weights = self._base.copy()
        for hidden, following in (("deform0", "deform_out"), ("density0", "density_out"), ("colour0", "colour_out")):
            at = self.field.layers[hidden]
            weights[at.offset : at.offset + at.size] *= 2.0**power
            at = self.field.layers[following]
            columns = at.inputs + at.pose
            weights[at.offset : at.offset + at.outputs * columns] *= 2.0**-power
        return self.field.bind(mi.Float(self._pose), FieldParameters(mi.Float(weights)))

    def arguments(self) -> tuple[mi.Point3f, mi.Vector3f, mi.Normal3f]:
        """Coordinates, with gradients enabled, directions and normals."""
        u, d, n = (np.ascontiguousarray(v.T) for v in (self.u, self.d, self.n))
        place = mi.Point3f(u)
        dr.enable_grad(place)
        return place, mi.Vector3f(d), mi.Normal3f(n)


@case("networks whose hidden values lie far beyond half precision (6e-8 to 65504), batched and fused",
      "hidden values times 2^-100 to 2^100", relative_to="density limit and white; gradients to the largest")
def hidden_values() -> Iterator[Measured]:
    """In single precision, as what is rendered and trained has unless half is asked for: where a backend's cooperative vectors have no
    other, :func:`ndf_mi.variants.fused_width` keeps to matrix products."""
    scaled = Scaled()
    limit = scaled.field.preset.density_limit
    for power in (-100, -60, -24, 0, 16, 17, 24, 60, 100):
        primal, gradient = 0.0, 0.0
        for fused in (False, True) if "single" in cooperative_precisions() else (False,):
            bound = scaled.bind(power)
            place, d, n = scaled.arguments()
            if fused:
                bound.pack()
            found, grey = bound.fused(list(place), d, n) if fused else bound.batched(list(place), d, n)
            dr.backward(dr.sum(found / limit + grey.x + grey.y + grey.z))
            primal = max(primal, error(found.numpy() / limit, scaled.sigma, 1.0), error(grey.numpy().T, scaled.colour, 1.0))
            gradient = max(gradient, error(dr.grad(place).numpy().T, scaled.slope, np.abs(scaled.slope).max()))
        yield Measured(f"2^{power}", primal, gradient)


@case("networks in half precision (`render --networks half`), and images of them: what overflows is told",
      "hidden values times 2^-24 to 2^24", primal=1e-2, gradient=None,
      relative_to="density limit and white, in 2^±10; beyond, finite or told")
def half_precision() -> Iterator[Measured]:
    """11 bits are 5e-4 of each of the terms of a sum, and encodings, weights and sums of a few layers add up. Below 6e-5, where weights get
    by 2^±15, bits are lost one by one. What overflows is told by a density of NaN, which an image refuses; all else is finite."""
    scaled = Scaled()
    for power in (-24, -20, -16, -10, -5, 0, 5, 10, 14, 15, 16, 17, 18, 20, 24):
        bound = scaled.bind(power)
        bound.pack(half=True)
        place, d, n = scaled.arguments()
        with dr.suspend_grad():
            found, grey = bound.fused(list(place), d, n)
        sigma, colour = found.numpy() / scaled.field.preset.density_limit, grey.numpy().T
        kept = ~np.isnan(sigma)
        off = max(error(sigma[kept], scaled.sigma[kept], 1.0), error(colour[kept], scaled.colour[kept], 1.0))
        if abs(power) > 10:
            off = 0.0 if off < np.inf else off
        elif not kept.all():
            off = np.inf
        yield Measured(f"2^{power}, {(~kept).sum()} of {len(kept)} told", off)
    with ridge() as ball:
        whole = ball.run.parameters.weights.numpy()
        at = ball.run.model.field.layers["density0"]
        for power in (0, 24):
            weights = whole.copy()
            weights[at.offset : at.offset + at.size] *= 2.0**power
            ball.run.parameters = ball.run.parameters.replace(weights=mi.Float(weights))
            camera = looking(np.array([0.0, 0.1, 1.0]), np.array([0.0, -0.1, -1.0]))
            try:
                image, single = (ImageRenderer(32)(ball.run.posed(0, networks), camera) for networks in ("half", "batched"))
                off = max(error(image.linear, single.linear, 1.0), error(image.opacity, single.opacity, 1.0))
                yield Measured(f"an image, 2^{power}", off if power == 0 and single.opacity.max() > 0.5 else np.inf)
            except InputError as refused:
                yield Measured(f"an image, 2^{power}", 0.0 if power and "--networks half" in str(refused) else np.inf)


@case("colours at 0 and 1: the networks' last layer, the sRGB curve and its inverse",
      "outputs of 0 and ±1e-3 to ±1e38; values of 0, 1e-38 to 10", relative_to="1, white, for the last layer; else the value")
def colours() -> Iterator[Measured]:
    """The curve's derivative jumps at its toe, where it is not tried."""
    def last(c: mi.Float) -> mi.Float:
        return BoundField.colour(mi.Color3f(c)).x

    for c in (0.0, *(sign * 10.0**k for k in (-3, -1, 0, 0.5, 1, 1.3, 2, 3, 10, 38) for sign in (1, -1))):
        at = np.float32(c) * np.array([1.0, 0.9], np.float32)
        s = logistic(at.astype(np.float64))
        by_s = np.where(s <= 0.04045, 1 / 12.92, 2.4 / 1.055 * ((s + 0.055) / 1.055) ** 1.4)
        value, slope = slope_of(last, at)
        yield Measured(f"output {c:g}", error(value, decode(s), 1.0), error(slope, by_s * s * (1 - s), 1.0))
    for x in (0.0, *(10.0**k for k in range(-38, 0, 4)), 0.003, 0.0033, 0.04, 0.041, 0.5, 1 - 6e-8, 1.0, 1 + 1e-6, 10.0):
        at = np.array([x], np.float32)
        exact = at.astype(np.float64)
        up, up_slope = slope_of(linear_to_srgb, at)
        down, down_slope = slope_of(srgb_to_linear, at)
        by_up = np.where(exact <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(exact, 1e-9) ** (1 / 2.4 - 1))
        by_down = np.where(exact <= 0.04045, 1 / 12.92, 2.4 / 1.055 * ((exact + 0.055) / 1.055) ** 1.4)
        yield Measured(f"value {x:g}", max(error(up, encode(exact)), error(down, decode(exact))),
                       max(error(up_slope, by_up), error(down_slope, by_down)))


@case("coordinates in the unit cube, at its edges and beyond it, in the hash grid", "inside, 0, 1, and ±1e-7 to ±1e38 beyond",
      relative_to="the largest entry of the table; derivatives to the largest inside")
def coordinates_beyond() -> Iterator[Measured]:
    """Levels that are dense and such that are hashed. Beyond the cube, features are the edge's, without a derivative across it; derivatives
    jump at the sides of cells and at the edges themselves, where they are not compared."""
    rng = np.random.default_rng(5)
    base = rng.uniform(0.2, 0.8, (60, 3)).astype(np.float32)
    for name, shape in (("tiny", preset("tiny")), ("hashed", dataclasses.replace(preset("tiny"), grid_entries=2**9))):
        encoding = GridEncoding(shape)
        table = np.random.default_rng(4).uniform(-1, 1, encoding.size).astype(np.float32)
        truth = Grid64(shape, table)
        largest = np.abs(truth(base)[1]).max()
        yield Measured(f"{name}, inside", *_compared(encoding, table, truth, base, largest))
        for edge in (0.0, 1.0):
            for off in (0.0, *(10.0**k for k in (-7, -5, -3, 0, 3, 10, 38))):
                beyond = base.copy()
                for axis in range(3):
                    beyond[axis::3, axis] = edge + (off if edge else -off)
                yield Measured(f"{name}, {edge:g}, {off:g} beyond", *_compared(encoding, table, truth, beyond, largest))


def _compared(encoding: GridEncoding, table: np.ndarray, truth: Grid64, at: np.ndarray, largest: float) -> tuple[float, float]:
    """Errors of features and of their derivatives, relative to 1 and to `largest`."""
    place = mi.Point3f(np.ascontiguousarray(at.T))
    dr.enable_grad(place)
    values = encoding(mi.Float(table), list(place))
    dr.backward(sum(dr.sum(value) for value in values))
    features, slopes, border = truth(at)
    smooth = (border > 1e-4)[:, None] & (at != 0) & (at != 1)
    found = dr.grad(place).numpy().T
    finite = np.isfinite(found).all()
    return (error(np.stack([value.numpy() for value in values], 1), features, 1.0),
            error(found[smooth], slopes[smooth], largest) if finite else np.inf)


@case("majorants against densities: from samples between nested shells, up to densities at their very limit",
      "limits of 1e-2 to 1e5 per metre", primal=0.0, gradient=None, relative_to="no density reaches its majorant")
def majorants() -> Iterator[Measured]:
    """At random points of the band, where the density's formula in float64 is compared with the majorant of the layer it is in. Half of
    the fields are so dense that they reach their limit."""
    with ridge() as ball:
        model = ball.run.model
        vertices = mi.Float(ball.vertices.ravel())
        weights = ball.run.parameters.weights.numpy()
        shape = model.field.preset
        for decade in (-2, 0, 3, 5):
            for peak in (PEAK, 30.0):
                limit = 10.0**decade
                model.field.preset = dataclasses.replace(shape, density_limit=limit, density_gain=limit / 3)
                weights[ball.peak] = peak
                ball.run.parameters = ball.run.parameters.replace(weights=mi.Float(weights))
                found = Majorants(model, ball.run.posed(0), vertices, 3, 0.05)
                rng = np.random.default_rng(6)
                way = rng.normal(size=(2000, 3))
                # Along a radius, the distance from the ball's facets is found by the projection, whose own cases are elsewhere.
                points = (way / np.linalg.norm(way, axis=1, keepdims=True) * rng.uniform(0.25, 0.38, (2000, 1))).astype(np.float32)
                l = ball.run.surface(0).project(mi.Point3f(np.ascontiguousarray(points.T))).l.numpy().astype(np.float64)
                layer = found.layers.locate(points)
                sigma = ball.density(l, peak)
                above = np.where(layer >= 0, sigma / np.array(found.values)[layer] - 1, np.where(sigma > 1e-6 * limit, np.inf, -1))
                equal = np.where((sigma > 0) & (above == 0), 1.0, 0.0)
                yield Measured(f"{limit:g}, {'at the limit' if peak > 1 else 'below it'}", max(0.0, float(above.max()), float(equal.max())))
        model.field.preset = shape


@case("a medium on a lattice that is everywhere as dense as its densest node: transmittance and gradient by prbvolpath",
      "optical depths of 1e-3 to 8", primal=5.0, gradient=5.0, relative_to="the standard error of the mean of 16 × 4096 paths", long=True)
def majorant_equals_density() -> Iterator[Measured]:
    """Free flights need a majorant strictly above the density, or gradients come out wrong: it is 1.05 times the densest node."""
    nodes, cell, side = 8, 0.2, 1.0
    medium = mi.load_dict({"type": "ndf_grid", "nx": nodes, "ny": nodes, "nz": nodes, "cell": cell})
    start = -0.5 * cell * (nodes - 1)
    cube = mi.ScalarTransform4f().scale(side / 2)
    scene = mi.load_dict({"type": "scene", "cube": {"type": "cube", "to_world": cube, "bsdf": {"type": "null"}, "interior": medium}})
    integrator = mi.load_dict({"type": "prbvolpath", "max_depth": 8, "hide_emitters": True})
    replay = Replay(scene, integrator, mi.Color3f(1.0))
    paths = 4096
    ray = mi.Ray3f(mi.Point3f(dr.full(mi.Float, 0.1, paths), 0.05, -2.0), mi.Vector3f(dr.zeros(mi.Float, paths), 0.0, 1.0))
    for tau in (1e-3, 1e-2, 0.1, 1.0, 3.0, 8.0):
        values = np.zeros((nodes**3, 4), np.float32)
        values[:, 0] = tau / side
        flat = mi.Float(values.ravel())
        dr.enable_grad(flat)
        medium.fill(flat, mi.Point3f(start), mi.Float(tau / side))
        through, slopes = [], []
        for seed in range(16):
            radiance = replay.radiance(ray, seed)
            through.append(float(dr.mean(radiance.x)[0]))
            dr.set_grad(flat, 0)
            replay.backward(ray, seed, radiance, mi.Color3f(1 / paths, 0, 0))
            slopes.append(float(dr.grad(flat).numpy().reshape(-1, 4)[:, 0].astype(np.float64).sum()))
        truth = np.exp(-tau)
        noise, slope_noise = (max(float(np.std(v, ddof=1)) / 4, 1e-7) for v in (through, slopes))
        yield Measured(f"{tau:g}", error(np.mean(through), truth, noise), error(np.mean(slopes), -side * truth, slope_noise))
