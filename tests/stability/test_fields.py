"""Networks and what they return: activations, colours, numbers beyond half precision; majorants."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.field import Field, FieldParameters, preset
from ndf_mi.field.encoding import GridEncoding
from ndf_mi.field.field import BoundField
from ndf_mi.render.image import ImageRenderer
from ndf_mi.stability.ball import looking, ridge
from ndf_mi.stability.case import Check, case, decades, error
from ndf_mi.stability.curves import decode, decode_slope, encode, encode_slope, logistic
from ndf_mi.stability.grid64 import Grid64
from ndf_mi.stability.network64 import Network64
from ndf_mi.variants import cooperative_precisions

JOINTS = 5


def slope_of(function: Callable[[mi.Float], mi.Float], at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives of a function of one number."""
    x = mi.Float(np.ascontiguousarray(at, np.float32))
    dr.enable_grad(x)
    value = function(x)
    dr.backward(dr.sum(value))
    return value.numpy().astype(np.float64), dr.grad(x).numpy().astype(np.float64)


@case("density from the network's output: exactly zero, just above it, up to its limit, under the majorant",
      "outputs of 0 and ±1e-38 to ±1e38")
@pytest.mark.parametrize(
    "z", [0.0, *decades(-38, 38, 2, (1, -1)), 3.0, 30.0, 100.0, -30.0, -80.0], ids="{:g}".format)
def test_activation(check: Check, z: float) -> None:
    """Both activations. The density never exceeds its limit, and the majorant stays 4 % above that."""
    at = (z * np.array([1.0, 0.7])).astype(np.float32)
    primal, gradient = 0.0, 0.0
    for name in ("fast", "paper"):
        field = Field(preset(name), JOINTS)
        bound, p = field.bind(dr.zeros(mi.Float, 3 * JOINTS), field.initial_parameters(1)), field.preset
        value, slope = slope_of(bound.activation, at)
        if p.density_activation == "softplus":
            shifted = (at + np.float32(p.density_bias)).astype(np.float64)
            a, da, kink = np.logaddexp(0, shifted), logistic(shifted), np.zeros(2, bool)
        else:
            # At 0, a ReLU has any derivative from 0 to 1.
            a, da, kink = np.maximum(at, 0).astype(np.float64), (at > 0).astype(np.float64), at == 0
        falling = np.exp(-a * p.density_gain / p.density_limit)
        primal = max(primal, error(value, -p.density_limit * np.expm1(-a * p.density_gain / p.density_limit)))
        gradient = max(gradient, error(slope[~kink], (p.density_gain * da * falling)[~kink]))
        assert (
            (value >= 0).all() and (value <= p.density_limit).all()
            and bound.majorant >= 1.04 * p.density_limit)
    check(primal, gradient)


class Scaled:
    """A network that stays the same while its hidden values grow or shrink: a ReLU layer times s, the next
    times 1/s.

    Attributes:
        field: with the encoding `frequency`.
        u, d, n: (64, 3) coordinates, directions and normals.
        sigma, colour: the reference there, over the density's limit and over white.
        slope: (64, 3) derivatives of σ / limit + r + g + b in u.
    """

    def __init__(self) -> None:
        shape = dataclasses.replace(
            preset("tiny"), encoding="frequency", octaves=3, deformation_scale=0.1, direction="mirrored")
        self.field = Field(shape, JOINTS)
        rng = np.random.default_rng(3)
        count = 64
        self.u = rng.uniform(0.1, 0.9, (count, 3)).astype(np.float32)
        d, n = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in rng.normal(size=(2, count, 3)))
        self.d, self.n = d.astype(np.float32), n.astype(np.float32)
        self._pose = rng.normal(0, 0.3, 3 * JOINTS).astype(np.float32)
        self._base = self.field.initial_parameters(2).weights.numpy().copy()
        # The products with the pose start at zero, which would hide errors in them.
        for layer in self.field.layers.values():
            self._base[layer.offset + layer.affine : layer.offset + layer.size] = rng.normal(
                0, 0.1, layer.size - layer.affine)
        truth = Network64(self.field, self._base, self._pose)

        def at(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            sigma, colour = truth(u, self.d.astype(np.float64), self.n.astype(np.float64))
            return sigma / shape.density_limit, colour

        exact = self.u.astype(np.float64)
        self.sigma, self.colour = at(exact)
        ends = [
            [sigma + colour.sum(1) for sigma, colour in (at(exact + way * e) for way in (1e-6, -1e-6))]
            for e in np.eye(3)]
        self.slope = np.stack([(after - before) / 2e-6 for after, before in ends], 1)

    def bind(self, power: int) -> BoundField:
        """The field with hidden values times 2^power."""
        weights = self._base.copy()
        for hidden, following in (
            ("deform0", "deform_out"), ("density0", "density_out"), ("colour0", "colour_out")):
            at = self.field.layers[hidden]
            weights[at.offset : at.offset + at.size] *= 2.0**power
            at = self.field.layers[following]
            weights[at.offset : at.offset + at.outputs * (at.inputs + at.pose)] *= 2.0**-power
        return self.field.bind(mi.Float(self._pose), FieldParameters(mi.Float(weights)))

    def arguments(self) -> tuple[mi.Point3f, mi.Vector3f, mi.Normal3f]:
        """Coordinates, with gradients enabled, directions and normals."""
        u, d, n = (np.ascontiguousarray(v.T) for v in (self.u, self.d, self.n))
        place = mi.Point3f(u)
        dr.enable_grad(place)
        return place, mi.Vector3f(d), mi.Normal3f(n)


@pytest.fixture(scope="module")
def scaled() -> Scaled:
    """Made once, because its reference takes a while."""
    return Scaled()


@case("networks whose hidden values lie far beyond half precision (6e-8 to 65504), batched and fused",
      "hidden values times 2^-100 to 2^100", relative_to="density limit and white; gradients to the largest")
@pytest.mark.parametrize("power", [-100, -60, -24, 0, 16, 17, 24, 60, 100], ids="2^{}".format)
def test_hidden_values(check: Check, scaled: Scaled, power: int) -> None:
    """In single precision, which rendering and training use unless half is asked for. Where a backend's
    cooperative vectors have only half precision, :func:`ndf_mi.variants.fused_width` chooses matrix
    products."""
    limit = scaled.field.preset.density_limit
    primal, gradient = 0.0, 0.0
    for fused in (False, True) if "single" in cooperative_precisions() else (False,):
        bound = scaled.bind(power)
        place, d, n = scaled.arguments()
        if fused:
            bound.pack()
        sigma, colour = (bound.fused if fused else bound.batched)(list(place), d, n)
        dr.backward(dr.sum(sigma / limit + colour.x + colour.y + colour.z))
        primal = max(
            primal, error(sigma.numpy() / limit, scaled.sigma, 1.0),
            error(colour.numpy().T, scaled.colour, 1.0))
        gradient = max(gradient, error(dr.grad(place).numpy().T, scaled.slope, np.abs(scaled.slope).max()))
    check(primal, gradient)


HALF = case("networks in half precision (`render --networks half`), and images of them: overflow is detected",
            "hidden values times 2^-24 to 2^24", primal=1e-2, gradient=None,
            relative_to="density limit and white, in 2^±10; beyond, finite or detected")


@HALF
@pytest.mark.parametrize(
    "power", [-24, -20, -16, -10, -5, 0, 5, 10, 14, 15, 16, 17, 18, 20, 24], ids="2^{}".format)
def test_half_precision(check: Check, scaled: Scaled, power: int) -> None:
    """11 bits are 5e-4 of each term of a sum, and the errors of encodings, weights and layers add up. Below
    6e-5, which weights reach at 2^±15, bits are lost one by one. Overflow becomes a density of NaN;
    everything else is finite."""
    bound = scaled.bind(power)
    bound.pack(half=True)
    place, d, n = scaled.arguments()
    with dr.suspend_grad():
        found, grey = bound.fused(list(place), d, n)
    sigma, colour = found.numpy() / scaled.field.preset.density_limit, grey.numpy().T
    kept = ~np.isnan(sigma)
    off = max(error(sigma[kept], scaled.sigma[kept], 1.0), error(colour[kept], scaled.colour[kept], 1.0))
    if abs(power) > 10:
        off = 0.0 if np.isfinite(off) else off
    else:
        assert kept.all()
    check(off, at=f"2^{power}, {(~kept).sum()} of {len(kept)} detected")


@HALF
@pytest.mark.parametrize("power", [0, 24], ids="an image, 2^{}".format)
def test_half_precision_image(check: Check, power: int) -> None:
    """An image is close to that in single precision, or refused where hidden values overflow."""
    with ridge() as ball:
        weights = ball.run.parameters.weights.numpy()
        at = ball.run.model.field.layers["density0"]
        weights[at.offset : at.offset + at.size] *= 2.0**power
        ball.set_weights(weights)
        camera = looking(np.array([0.0, 0.1, 1.0]), np.array([0.0, -0.1, -1.0]))
        if power:
            with pytest.raises(InputError, match="--networks half"):
                ImageRenderer(32)(ball.run.posed(0, "half"), camera)
            check(0.0)
        else:
            image, single = (
                ImageRenderer(32)(ball.run.posed(0, networks), camera) for networks in ("half", "batched"))
            assert single.opacity.max() > 0.5
            check(max(error(image.linear, single.linear, 1.0), error(image.opacity, single.opacity, 1.0)))


COLOURS = case(
    "colours at 0 and 1: the networks' last layer, the sRGB curve and its inverse",
    "outputs of 0 and ±1e-3 to ±1e38; values of 0, 1e-38 to 10",
    relative_to="1, white, for the last layer; else the value")


@COLOURS
@pytest.mark.parametrize(
    "c", [0.0, *(sign * 10.0**k for k in (-3, -1, 0, 0.5, 1, 1.3, 2, 3, 10, 38) for sign in (1, -1))],
    ids="output {:g}".format)
def test_colours(check: Check, c: float) -> None:
    at = np.float32(c) * np.array([1.0, 0.9], np.float32)
    s = logistic(at.astype(np.float64))
    value, slope = slope_of(lambda x: BoundField.colour(mi.Color3f(x)).x, at)
    check(error(value, decode(s), 1.0), error(slope, decode_slope(s) * s * (1 - s), 1.0))


@COLOURS
@pytest.mark.parametrize(
    "x", [0.0, *decades(-38, -2, 4), 0.003, 0.0033, 0.04, 0.041, 0.5, 1 - 6e-8, 1.0, 1 + 1e-6, 10.0],
    ids="value {:g}".format)
def test_colours_of_the_curve(check: Check, x: float) -> None:
    """Except at its toe, where the curve's derivative jumps."""
    at = np.array([x], np.float32)
    exact = at.astype(np.float64)
    (up, up_slope), (down, down_slope) = slope_of(linear_to_srgb, at), slope_of(srgb_to_linear, at)
    check(max(error(up, encode(exact)), error(down, decode(exact))),
          max(error(up_slope, encode_slope(exact)), error(down_slope, decode_slope(exact))))


@case(
    "coordinates in the unit cube, at its edges and beyond it, in the hash grid",
    "inside, 0, 1, and ±1e-7 to ±1e38 beyond",
    relative_to="the largest entry of the table; derivatives to the largest inside")
@pytest.mark.parametrize(
    "off", [None, 0.0, *(10.0**k for k in (-7, -5, -3, 0, 3, 10, 38))], ids=lambda off: f"{off} beyond")
@pytest.mark.parametrize("entries", [None, 2**9], ids=["dense", "hashed"])
def test_coordinates_beyond(check: Check, entries: int | None, off: float | None) -> None:
    """Beyond the cube, features are those of its side, with no derivative across it. Derivatives jump at the
    sides of cells and of the cube, where they are not compared."""
    shape = preset("tiny") if entries is None else dataclasses.replace(preset("tiny"), grid_entries=entries)
    encoding = GridEncoding(shape)
    table = np.random.default_rng(4).uniform(-1, 1, encoding.size).astype(np.float32)
    truth = Grid64(shape, table)
    base = np.random.default_rng(5).uniform(0.2, 0.8, (60, 3)).astype(np.float32)
    largest = np.abs(truth(base)[1]).max()
    places = [base]
    if off is not None:
        places = [base.copy(), base.copy()]
        for axis in range(3):
            places[0][axis::3, axis], places[1][axis::3, axis] = -off, 1 + off
    for at in places:
        place = mi.Point3f(np.ascontiguousarray(at.T))
        dr.enable_grad(place)
        values = encoding(mi.Float(table), list(place))
        dr.backward(sum(dr.sum(value) for value in values))
        features, slopes, border = truth(at)
        smooth = (border > 1e-4)[:, None] & (at != 0) & (at != 1)
        found = dr.grad(place).numpy().T
        assert np.isfinite(found).all()
        check(
            error(np.stack([value.numpy() for value in values], 1), features, 1.0),
            error(found[smooth], slopes[smooth], largest))
