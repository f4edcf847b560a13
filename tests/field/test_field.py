"""The networks against a float64 evaluation in numpy, written from the paper's table, and against finite
differences."""

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.errors import InputError
from ndf_mi.field import PRESETS, Field, FieldParameters, Preset, preset

JOINTS = 24


def inputs(n=200, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.uniform(0.02, 0.98, (3, n))
    d = rng.normal(size=(3, n))
    return u, d / np.linalg.norm(d, axis=0), rng.normal(0, 0.4, 3 * JOINTS)


def evaluate(field, parameters, u, d, pose, mode):
    bound = field.bind(mi.Float(pose.astype(np.float32)), parameters)
    n = d[[2, 0, 1]]
    u, d, n = (values.astype(np.float32) for values in (u, d, n))
    arguments = mi.Point3f(u), mi.Vector3f(d), mi.Normal3f(n)
    if mode == "fused":
        bound.pack()
    return getattr(bound, mode)(*arguments)


def with_grid_times(parameters, factor):
    return parameters if parameters.grid is None else parameters.replace(grid=parameters.grid * factor)


def gamma(x, octaves):
    rows = [x]
    for k in range(octaves):
        rows += [np.sin(2.0**k * x), np.cos(2.0**k * x)]
    return np.concatenate(rows)


class PaperInNumpy:
    """The published architecture, layer by layer, reading its matrices off the flat vector one after another.
    """

    def __init__(self, weights):
        self.rest = weights.astype(np.float64)

    def layer(self, inputs, outputs):
        count = inputs * outputs
        w, b, self.rest = np.split(self.rest, (count, count + outputs))
        w = w.reshape(outputs, inputs)
        return lambda x: w @ x + b[:, None]

    def __call__(self, u, d, pose, limit):
        relu = lambda x: np.maximum(x, 0)  # noqa: E731
        n = u.shape[1]
        f = relu(self.layer(72, 256)(pose[:, None]))
        f = np.repeat(relu(self.layer(256, 128)(f)), n, axis=1)
        h = relu(self.layer(191, 128)(np.concatenate([gamma(u, 10), f])))
        u = u + 0.001 * self.layer(128, 3)(h)
        g = gamma(u, 10)
        h = relu(self.layer(191, 256)(np.concatenate([g, f])))
        for _ in range(4):
            h = relu(self.layer(256, 256)(h))
        # The flat vector keeps the pose's columns last; joined inputs are γ, h, pose.
        h = relu(self.layer(447, 256)(np.concatenate([g, h, f])))
        h = relu(self.layer(256, 256)(h))
        sigma = relu(self.layer(256, 1)(h))[0]
        h = self.layer(256, 256)(h)
        h = self.layer(384, 256)(np.concatenate([h, f]))
        h = relu(self.layer(283, 128)(np.concatenate([h, gamma(d, 4)])))
        srgb = 1 / (1 + np.exp(-self.layer(128, 3)(h)))
        assert self.rest.size == 0
        linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        return limit * (1 - np.exp(-sigma / limit)), linear


def test_paper_has_the_published_number_of_parameters():
    assert Field(preset("paper"), JOINTS).size == 770_695


@pytest.mark.parametrize("mode", ["batched", "fused"])
def test_paper_agrees_with_float64(mode):
    field = Field(preset("paper"), JOINTS)
    # Ten times the usual weights in the last density layer, so that densities are far from zero.
    weights = field.initial_parameters(3).weights.numpy()
    out = field.layers["density_out"]
    weights[out.offset : out.offset + out.size] *= 200
    u, d, pose = inputs()
    sigma, colour = evaluate(field, FieldParameters(mi.Float(weights)), u, d, pose, mode)
    expected_sigma, expected_colour = PaperInNumpy(weights)(u, d, pose, field.preset.density_limit)
    assert expected_sigma.max() > 1
    # The highest octave turns float32's rounding of u (6e-8) into 3e-5 radians.
    np.testing.assert_allclose(sigma.numpy(), expected_sigma, rtol=2e-4, atol=2e-4 * expected_sigma.max())
    np.testing.assert_allclose(colour.numpy(), expected_colour, atol=2e-5)


@pytest.mark.parametrize("name", ["fast", "tiny", pytest.param("paper", marks=pytest.mark.long)])
def test_batched_and_fused_agree_in_value_and_gradient(name):
    u, d, pose = inputs()
    results = []
    for mode in ("batched", "fused"):
        field = Field(preset(name), JOINTS)
        parameters = with_grid_times(field.initial_parameters(1), 1e4)
        dr.enable_grad(parameters)
        leaves = [leaf for leaf in (parameters.weights, parameters.grid) if leaf is not None]
        sigma, colour = evaluate(field, parameters, u, d, pose, mode)
        dr.backward(dr.mean(0.01 * sigma + colour.x + 2 * colour.y + 3 * colour.z))
        results.append([sigma.numpy(), colour.numpy(), *[dr.grad(leaf).numpy() for leaf in leaves]])
    for batched, fused in zip(*results, strict=True):
        assert np.abs(batched).max() > 0
        np.testing.assert_allclose(fused, batched, rtol=0, atol=1e-5 * np.abs(batched).max())


@pytest.mark.parametrize("name", ["fast", "tiny"])
def test_gradients_agree_with_finite_differences(name):
    field = Field(preset(name), JOINTS)
    u, d, pose = inputs(2000)
    values = {key: value.astype(np.float64)
              for key, value in with_grid_times(field.initial_parameters(2), 3e3).arrays().items()}
    for layer in field.layers.values():
        # Products start at zero, through which no gradient would get to the pose's layers.
        products = np.random.default_rng(6).normal(0, 0.2, layer.size - layer.affine)
        values["weights"][layer.offset + layer.affine : layer.offset + layer.size] = products

    def evaluate_at(which, change):
        changed = {key: mi.Float((value + (change if key == which else 0)).astype(np.float32))
                   for key, value in values.items()}
        leaf = changed[which]
        dr.enable_grad(leaf)
        sigma, colour = evaluate(field, FieldParameters(**changed), u, d, pose, "batched")
        return 0.02 * sigma + colour.x + 2 * colour.y, leaf

    for which, scale in (("weights", 1e-4), ("grid", 1e-2)):
        out, leaf = evaluate_at(which, 0)
        dr.backward(dr.sum(out))
        gradient = dr.grad(leaf).numpy().astype(np.float64)
        # A random direction in the gradient's orthant: entries add up instead of cancelling, so that rounding
        # stays small.
        direction = scale * np.random.default_rng(5).uniform(0, 1, gradient.size) * np.sign(gradient)
        ahead, behind = (evaluate_at(which, step * direction)[0].numpy().astype(np.float64).sum()
                         for step in (1, -1))
        assert (ahead - behind) / 2 == pytest.approx(float(gradient @ direction), rel=1e-2)


def test_density_stays_below_the_majorant_however_large_the_weights():
    for name in PRESETS:
        field = Field(preset(name), JOINTS)
        parameters = field.initial_parameters(1)
        sigma, colour = evaluate(field, parameters.replace(weights=parameters.weights * 50), *inputs(),
                                 "batched")
        assert np.isfinite(sigma.numpy()).all() and np.isfinite(colour.numpy()).all()
        assert sigma.numpy().max() <= field.preset.density_limit < field.majorant
        assert sigma.numpy().min() >= 0


def with_pose_only_in(field, network):
    """Parameters whose pose columns are zero but in the layers whose names begin so, with effects large
    enough to be seen."""
    parameters = with_grid_times(field.initial_parameters(1), 1e4)
    weights = parameters.weights.numpy()
    for name, layer in field.layers.items():
        if layer.pose and not name.startswith(network):
            columns = layer.inputs + layer.pose
            matrix = weights[layer.offset : layer.offset + layer.outputs * columns]
            matrix.reshape(layer.outputs, columns)[:, layer.inputs :] = 0
            weights[layer.offset + layer.affine : layer.offset + layer.size] = 0
    # The first row of the last layer, which is the density's; and the deformation's last layer, which starts
    # at a hundredth.
    density, deformation = field.layers["density_out"], field.layers["deform_out"]
    weights[density.offset : density.offset + density.inputs] *= 20
    weights[deformation.offset : deformation.offset + deformation.size] *= 100
    return parameters.replace(weights=mi.Float(weights))


@pytest.mark.parametrize(("name", "mode"), [
    *((name, "batched") for name in PRESETS), ("tiny", "fused"),
    *(pytest.param(name, "fused", marks=pytest.mark.long) for name in ("fast", "paper")),
])  # fmt: skip
@pytest.mark.parametrize(("network", "density", "colour"), [
    ("density", True, True),  # the colour network is fed by the density's
    ("deform", True, True),
    (("linear", "colour"), False, True),
    ((), False, False),
])  # fmt: skip
def test_the_pose_reaches_density_deformation_and_colour(name, network, density, colour, mode):
    """Of every network on its own: with its columns of the pose alone, density and colour change with the
    pose where they should."""
    # The published deformation is a thousandth of the unit cube: made larger, it can be told from rounding.
    field = Field(dataclasses.replace(preset(name), deformation_scale=0.1), JOINTS)
    parameters = with_pose_only_in(field, network)
    u, d, pose = inputs()
    before, after = (evaluate(field, parameters, u, d, p, mode) for p in (pose, pose + 0.5))
    for changes, a, b in zip((density, colour), before, after, strict=True):
        difference = np.abs(a.numpy() - b.numpy()).max() / np.abs(a.numpy()).max()
        assert difference > 1e-4 if changes else difference == 0, (name, network, difference)


def test_presets_go_through_dictionaries():
    for value in PRESETS.values():
        assert Preset.from_dict(value.to_dict()) == value


@pytest.mark.parametrize(
    ("change", "word"), [({"band": -1.0}, "band"), ({"encoding": "sphere"}, "encoding"),
                         ({"density_layers": ()}, "density")]
)
def test_wrong_options_are_named(change, word):
    with pytest.raises(InputError, match=word):
        dataclasses.replace(preset("fast"), **change)
    with pytest.raises(InputError, match="no-such"):
        Preset.from_dict({"no-such": 1})
    with pytest.raises(InputError, match="paper"):
        preset("nerf")


def test_the_normal_changes_colour_alone_and_only_where_the_preset_uses_it():
    u, d, pose = inputs()
    for name, expected in (("fast", True), ("paper", False)):
        field = Field(preset(name), JOINTS)
        bound = field.bind(mi.Float(pose.astype(np.float32)), field.initial_parameters(1))
        arguments = mi.Point3f(u.astype(np.float32)), mi.Vector3f(d.astype(np.float32))
        (sigma, colour), (other_sigma,
                          other_colour) = (bound.batched(*arguments, mi.Normal3f(*n))
                                           for n in ((0, 0, 1), (0, 1, 0)))
        assert (sigma.numpy() == other_sigma.numpy()).all()
        assert bool((colour.numpy() != other_colour.numpy()).any()) is expected


def test_the_direction_changes_colour_alone_and_only_where_the_preset_uses_it():
    u, d, pose = inputs()
    for octaves in (-1, 0, 2):
        field = Field(dataclasses.replace(preset("tiny"), direction_octaves=octaves, normal_octaves=-1),
                      JOINTS)
        there, back = (evaluate(field, field.initial_parameters(3), u, sign * d, pose, "batched")
                       for sign in (1, -1))
        assert dr.all(there[0] == back[0])
        assert (np.abs(np.array(there[1]) - np.array(back[1])).max() > 1e-4) == (octaves >= 0)


def test_the_mirrored_direction_is_what_highlights_follow():
    """Colours are those of the direction that light comes from by reflection, however viewer and surface
    share the turning."""
    u, d, pose = inputs()
    colours = {}
    for kind in ("mirrored", "view"):
        field = Field(dataclasses.replace(preset("tiny"), direction=kind, normal_octaves=-1), JOINTS)
        bound = field.bind(mi.Float(pose.astype(np.float32)), field.initial_parameters(3))
        found = []
        for normal in ((0.0, 0.0, 1.0), (0.6, 0.0, -0.8)):
            n = np.array(normal)[:, None]
            viewed = d - 2 * (d * n).sum(0) * n
            _, colour = bound.batched(mi.Point3f(u.astype(np.float32)),
                                      mi.Vector3f(viewed.astype(np.float32)), mi.Normal3f(*normal))
            found.append(colour.numpy())
        colours[kind] = np.abs(found[0] - found[1]).max()
    assert colours["mirrored"] < 1e-5 and colours["view"] > 1e-3


@pytest.mark.parametrize("mode", ["batched", "fused"])
def test_the_pose_mixes_matrices(mode):
    """A field at a pose is one without products whose matrices are W + Σ_k f_k·W_k, the features f from
    numpy."""
    shape = dataclasses.replace(preset("tiny"), density_skip=0)
    field, plain = Field(shape, JOINTS), Field(dataclasses.replace(shape, pose_products=False), JOINTS)
    parameters = with_grid_times(field.initial_parameters(3), 1e4)
    u, d, pose = inputs()
    weights = parameters.weights.numpy().copy()
    rng = np.random.default_rng(7)
    features = pose.astype(np.float64)
    for i in range(len(shape.pose_layers)):
        layer = field.layers[f"pose{i}"]
        part = weights[layer.offset : layer.offset + layer.affine].astype(np.float64)
        count = layer.outputs * layer.inputs
        features = np.maximum(part[:count].reshape(layer.outputs, layer.inputs) @ features + part[count:], 0)
    assert (features > 0).sum() >= 2
    expected = plain.initial_parameters(3).weights.numpy().copy()
    for name, layer in field.layers.items():
        other = plain.layers[name]
        part = weights[layer.offset : layer.offset + layer.affine].copy()
        if layer.products:
            mixed = rng.normal(0, 1, (layer.outputs, layer.inputs, layer.pose)).astype(np.float32)
            weights[layer.offset + layer.affine : layer.offset + layer.size] = mixed.ravel()
            matrix = part[: layer.outputs * (layer.inputs + layer.pose)].reshape(layer.outputs, -1)
            matrix[:, : layer.inputs] += (mixed @ features).astype(np.float32)
        expected[other.offset : other.offset + other.size] = part
    before = evaluate(field, parameters, u, d, pose, mode)
    mixed = evaluate(field, parameters.replace(weights=mi.Float(weights)), u, d, pose, mode)
    by_hand = evaluate(plain, parameters.replace(weights=mi.Float(expected)), u, d, pose, mode)
    for ours, theirs, unmixed in zip(mixed, by_hand, before, strict=True):
        ours, theirs, unmixed = ours.numpy(), theirs.numpy(), unmixed.numpy()
        np.testing.assert_allclose(ours, theirs, atol=1e-5 * np.abs(theirs).max())
        assert np.abs(ours - unmixed).max() > 1e-2 * np.abs(theirs).max()


@pytest.mark.parametrize("name", ["fast", "paper"])
def test_presets_written_before_there_was_a_choice_take_the_view_direction_and_no_products(name):
    values = preset(name).to_dict()
    values.pop("pose_products", None)
    assert "direction" not in values
    assert Preset.from_dict(values) == dataclasses.replace(preset(name), pose_products=False)


def test_a_direction_that_nothing_takes_is_refused():
    with pytest.raises(InputError, match="direction_octaves"):
        dataclasses.replace(preset("fast"), direction="mirrored")
    mirrored = dataclasses.replace(preset("fast"), direction="mirrored", direction_octaves=2)
    assert Preset.from_dict(mirrored.to_dict()) == mirrored
