"""The networks against numpy in double precision, and their sizes against the published ones."""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters
from ndf_mi.methods.animatable_nerf.architecture import FAST, PAPER
from ndf_mi.methods.animatable_nerf.method import AnimatableNerf
from ndf_mi.methods.animatable_nerf.networks import BlendNetwork, CanonicalField, Codes


def test_the_published_sizes() -> None:
    """For SMPL's 24 joints and a capture with 60 training frames, layer by layer."""
    blend = (191 + 1) * 256 + 4 * 257 * 256 + (191 + 256 + 1) * 256 + 2 * 257 * 256 + 257 * 24
    assert BlendNetwork(PAPER, 24).size == blend == 564_760
    density = (63 + 1) * 256 + 4 * 257 * 256 + (63 + 256 + 1) * 256 + 2 * 257 * 256 + 257
    colour = 257 * 256 + (256 + 128 + 1) * 256 + (256 + 27 + 1) * 128 + 129 * 3
    field = CanonicalField(PAPER)
    assert (field.size, field.grid_size) == (density + colour, 0) and density + colour == 694_404
    codes = Codes(61, PAPER.blend_latent), Codes(60, PAPER.colour_latent)
    rng = np.random.default_rng(0)
    assert [code.initial(rng).size for code in codes] == [61 * 128, 60 * 128]


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(InputError, match="fast"):
        AnimatableNerf("quick")


def encoded(x: np.ndarray, octaves: int) -> np.ndarray:
    parts = [x]
    for octave in range(octaves):
        parts += [np.sin(x * 2**octave), np.cos(x * 2**octave)]
    return np.concatenate(parts, axis=1)


@pytest.mark.parametrize("shape", [
    dataclasses.replace(PAPER, blend_layers=(16,) * 8, blend_octaves=4),
    FAST,
], ids=["skip", "fast"])
def test_the_blend_network_agrees_with_float64(shape) -> None:
    network, rng = BlendNetwork(shape, 7), np.random.default_rng(3)
    weights, code = network.initial(rng), rng.standard_normal(shape.blend_latent).astype(np.float32)
    x = rng.uniform(-1, 1, (300, 3)).astype(np.float32)

    inputs = np.c_[encoded(x.astype(np.float64), shape.blend_octaves), np.tile(code, (300, 1))]
    h, offset, expected = inputs, 0, None
    for i, width in enumerate([*shape.blend_layers, 7]):
        if i == shape.blend_skip and i > 0:
            # The code's columns come last.
            h = np.c_[inputs[:, :-shape.blend_latent], h, inputs[:, -shape.blend_latent:]]
        matrix = weights[offset : offset + width * h.shape[1]].reshape(width, -1).astype(np.float64)
        offset += width * h.shape[1]
        expected = h @ matrix.T + weights[offset : offset + width]
        h, offset = np.maximum(expected, 0), offset + width
    assert offset == network.size == len(weights)

    point = mi.Point3f(np.ascontiguousarray(x.T))
    attached = mi.Float(weights)
    dr.enable_grad(attached)
    for bound in (network.bind(mi.Float(code), mi.Float(weights)), network.bind(mi.Float(code), attached)):
        np.testing.assert_allclose(bound(point).numpy().T, expected, atol=3e-5)


def test_codes_change_colours_and_not_the_density() -> None:
    field, rng = CanonicalField(FAST), np.random.default_rng(4)
    codes = Codes(3, FAST.colour_latent)
    table = mi.Float(codes.initial(rng))
    parameters = field.initial_parameters(0)
    u = [mi.Float(column) for column in rng.random((3, 50), dtype=np.float32)]
    nothing = dr.zeros(mi.Vector3f, 50)
    seen = [field.bind(codes(table, row), parameters).batched(u, nothing, mi.Normal3f(nothing))
            for row in (0, 2)]
    np.testing.assert_array_equal(seen[0][0].numpy(), seen[1][0].numpy())
    assert np.abs(seen[0][1].numpy() - seen[1][1].numpy()).max() > 1e-3


def test_a_code_is_a_row_of_its_table() -> None:
    codes = Codes(4, 5)
    table = np.arange(20, dtype=np.float32)
    np.testing.assert_array_equal(codes(mi.Float(table), 2).numpy(), table[10:15])


def test_the_canonical_colours_agree_with_float64() -> None:
    """With the published layers, narrower: the code joins the second linear layer, the direction follows."""
    canonical = dataclasses.replace(PAPER.canonical, density_layers=(16,) * 8, colour_linear=(16, 16),
                                    colour_layers=(8,), octaves=3)
    shape = dataclasses.replace(PAPER, canonical=canonical, colour_latent=5)
    field, rng = CanonicalField(shape), np.random.default_rng(6)
    weights = field.initial_parameters(1).weights.numpy().astype(np.float64)
    code, x = rng.standard_normal(5).astype(np.float32), rng.uniform(-1, 1, (40, 3)).astype(np.float32)
    d = rng.normal(size=(40, 3))
    d = (d / np.linalg.norm(d, axis=1, keepdims=True)).astype(np.float32)
    taken = 0

    def affine(h: np.ndarray, width: int) -> np.ndarray:
        nonlocal taken
        matrix = weights[taken : taken + width * h.shape[1]].reshape(width, -1)
        taken += width * (h.shape[1] + 1)
        return h @ matrix.T + weights[taken - width : taken]

    point = encoded(x.astype(np.float64), 3)
    h = point
    for i in range(8):
        h = np.maximum(affine(np.c_[point, h] if i == 5 else h, 16), 0)
    sigma = np.maximum(affine(h, 1)[:, 0], 0)
    h = affine(h, 16)
    h = affine(np.c_[h, np.tile(code, (40, 1))], 16)
    h = np.maximum(affine(np.c_[h, encoded(d.astype(np.float64), 4)], 8), 0)
    srgb = 1 / (1 + np.exp(-affine(h, 3)))
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)

    bound = field.bind(mi.Float(code), FieldParameters(mi.Float(weights.astype(np.float32))))
    found = bound.batched(list(mi.Point3f(np.ascontiguousarray(x.T))), mi.Vector3f(np.ascontiguousarray(d.T)),
                          dr.zeros(mi.Normal3f, 40))
    np.testing.assert_allclose(found[0].numpy(), sigma, atol=1e-4)
    np.testing.assert_allclose(found[1].numpy().T, linear, atol=1e-5)
