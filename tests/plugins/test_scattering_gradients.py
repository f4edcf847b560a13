"""Gradients of `prbvolpath` through a field, in its weights and hash table, against central differences of
independent renders.

Directions are random in the orthant of the gradient (from renders of their own), so that derivatives along
them are not lost in noise. Differences between differences and gradients are held against three standard
errors of both. Light comes mostly from one side, albedo is coloured, paths have up to five vertices.

In a thin medium steps that can be told from noise are too large for differences. There light scatters once or
not at all, and what a ray sees is, to first order in the depth, what emission and absorption make of it if
every point emits its albedo times the mean light of all directions. Quadrature has no noise, and differences
of it are as good as float32 allows.
"""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.field import FieldParameters
from ndf_mi.learn.scattering_scene import ScatteringScene
from ndf_mi.render.quadrature import quadrature
from ndf_mi.render.replay import Replay

RADIUS, BAND = 0.3, 0.08
#: Optical depth of the band along its normal.
THIN, ORDINARY, THICK = 0.005, 2.0, 20.0
ERRORS = 3
BEHIND = (0.3, 0.5, 0.2)


def lights():
    return {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.3, 0.4]}},
            "sun": {"type": "directional", "direction": [0.5, -0.6, -1],
                    "irradiance": {"type": "rgb", "value": [2.0, 1.6, 1.2]}}}


def uneven(make_constant_run, depth, **changes):
    """A field of about that optical depth, which varies by some ten percent from place to place, as its
    albedo does."""
    run = make_constant_run(depth / (2 * BAND), srgb=(0.9, 0.7, 0.5), direction_octaves=-1, normal_octaves=-1,
                            **changes)
    field = run.model.field
    weights, rng = run.parameters.weights.numpy(), np.random.default_rng(3)
    for name, row, size in (("density_out", 0, 0.3), *(("colour_out", row, 0.5) for row in range(3))):
        at = field.layers[name]
        start = at.offset + row * (at.inputs + at.pose)
        # Relative to the network's output: what it means in density depends on where the activation is.
        weights[start : start + at.inputs] = size * rng.normal(size=at.inputs)
    grid = mi.Float(0.5 * rng.normal(size=field.grid_size).astype(np.float32)) if field.grid_size else None
    run.parameters = FieldParameters(mi.Float(weights), grid)
    run.save()
    return run


def mean_light():
    """(3,) the mean radiance over all directions of `lights`: a directional one's irradiance reaches a
    scatterer whole."""
    sky, sun = lights()["sky"]["radiance"]["value"], lights()["sun"]["irradiance"]["value"]
    return np.array(sky) + np.array(sun) / (4 * np.pi)


def rays(count, rng):
    """Parallel rays through a square around the ball."""
    x, y = rng.uniform(-0.35, 0.35, (2, count)).astype(np.float32)
    return mi.Ray3f(mi.Point3f(x, y, 2.0), mi.Vector3f(dr.zeros(mi.Float, count), 0.0, -1.0))


class Direct:
    """The medium `ndf` itself."""

    def __init__(self, run):
        self.scene = mi.load_dict({"type": "scene", **lights(), "performer": {
            "type": "ndf_shell", "interior": {"type": "ndf", "run": str(run.path), "frame": 0}}})
        self.parameters = mi.traverse(self.scene)

    def set(self, values, wanted):
        for name, value in values.items():
            key = f"performer.interior_medium.{name}"
            self.parameters[key] = mi.Float(value)
            if wanted:
                dr.enable_grad(self.parameters[key])
        self.parameters.update()

    def gradients(self, names):
        return {name: dr.grad(self.parameters[f"performer.interior_medium.{name}"]).numpy() for name in names}


class OnGrid:
    """The field sampled on a grid, as in training."""

    def __init__(self, run):
        self.run = run
        self.stage = ScatteringScene(run, [0], {key: mi.load_dict(value) for key, value in lights().items()},
                                     0.02)
        self.scene = self.stage.scene

    def set(self, values, wanted):
        self.values = {name: mi.Float(value) for name, value in values.items()}
        if wanted:
            dr.enable_grad(self.values)
        posed = self.run.posed(0, parameters=self.run.parameters.replace(**self.values))
        self.baked, self.nodes = self.stage.place(posed, 0, np.full(3, 0.3))

    def gradients(self, names):
        dr.backward(self.baked.vjp(dr.grad(self.nodes)))
        return {name: dr.grad(self.values[name]).numpy() for name in names}


class Measured:
    """Means of the light along rays, weighted unevenly over the channels, and their gradients: each call with
    other rays and paths."""

    WEIGHTS = (0.5, 1.0, 0.7)

    def __init__(self, place):
        self.place = place
        integrator = mi.load_dict({"type": "prbvolpath", "max_depth": 6, "rr_depth": 1000,
                                   "hide_emitters": True})
        self.replay = Replay(place.scene, integrator, mi.Color3f(*BEHIND))
        self.seed = 0

    def mean(self, count):
        self.seed += 1
        radiance = self.replay.radiance(rays(count, np.random.default_rng(self.seed)), self.seed)
        return float(sum(w * dr.mean(channel) for w, channel in zip(self.WEIGHTS, radiance, strict=True))[0])

    def gradient(self, values, count):
        self.seed += 1
        self.place.set(values, wanted=True)
        ray = rays(count, np.random.default_rng(self.seed))
        radiance = self.replay.radiance(ray, self.seed)
        self.replay.backward(ray, self.seed, radiance, mi.Color3f(*self.WEIGHTS) / count)
        return self.place.gradients(values)


def derivatives(measured, values, paths, repeats):
    """For each parameter its name, a direction, the derivative along it, its standard error: from `repeats`
    gradients of `paths` each."""
    rng = np.random.default_rng(5)
    guess = measured.gradient(values, paths)
    found = [measured.gradient(values, paths) for _ in range(repeats)]
    for name, value in values.items():
        direction = np.abs(rng.normal(size=value.shape)) * np.sign(guess[name])
        direction /= np.linalg.norm(direction)
        along = np.array([np.dot(g[name].astype(np.float64), direction) for g in found])
        yield name, direction, along.mean(), along.std(ddof=1) / np.sqrt(repeats)


def check(place, values, change, paths, repeats, forward):
    """Derivatives along one random direction a parameter.

    Args:
        change: relative change of the mean by a step of the differences, about.
        paths, repeats: of a gradient, and how many are averaged.
        forward: paths of a render for the differences.
    """
    measured = Measured(place)
    for name, direction, gradient, error in derivatives(measured, values, paths, repeats):
        value = values[name]
        step = change * measured.mean(forward) / abs(gradient)
        sides = []
        for sign in (1, -1):
            place.set({**values, name: (value + sign * step * direction).astype(np.float32)}, wanted=False)
            sides.append([measured.mean(forward) for _ in range(4)])
        difference = (np.mean(sides[0]) - np.mean(sides[1])) / (2 * step)
        noise = np.sqrt(np.var(sides[0], ddof=1) + np.var(sides[1], ddof=1)) / (2 * step) / 2
        assert abs(gradient - difference) < ERRORS * np.hypot(error,
                                                              noise), (name, gradient, difference, error,
                                                                       noise)
        # The comparison means something: the noise is small itself.
        assert error < 0.1 * abs(gradient) and noise < 0.1 * abs(gradient), (name, gradient, error, noise)
        place.set(values, wanted=False)


def thin_mean(run, values):
    """What `Measured.mean` is to first order in the depth, by quadrature along a grid of rays."""
    parameters = FieldParameters(mi.Float(values["weights"]), mi.Float(values["grid"]))
    x, y = ((np.stack(np.meshgrid(*[np.arange(96)] * 2)).reshape(2, -1) + 0.5) / 96 - 0.5) * 0.7
    ray = mi.Ray3f(mi.Point3f(x.astype(np.float32), y.astype(np.float32), 2.0), mi.Vector3f(0.0, 0.0, -1.0))
    seen = quadrature(run.posed(0, parameters=parameters), ray, 512)
    colour = np.stack([channel.numpy() for channel in seen.colour]).astype(np.float64)
    opacity = seen.opacity.numpy().astype(np.float64)
    radiance = mean_light()[:, None] * colour + np.array(BEHIND)[:, None] * (1 - opacity)
    return float(np.dot(Measured.WEIGHTS, radiance.mean(1)))


@pytest.mark.long
def test_gradients_in_a_thin_medium_are_those_of_single_scattering(make_constant_run):
    run = uneven(make_constant_run, THIN, grid_levels=2)
    values = run.field_tensors()
    for name, direction, gradient, error in derivatives(Measured(OnGrid(run)), values, 1 << 17, repeats=6):
        value = values[name]
        sides = [thin_mean(run, {**values, name: (value + sign * 0.03 * direction).astype(np.float32)})
                 for sign in (1, -1)]
        difference = (sides[0] - sides[1]) / 0.06
        # What second order adds: less than the longest way's depth, through the band twice or along it, of
        # the derivative.
        second = 10 * THIN * abs(difference)
        assert abs(gradient - difference) < ERRORS * error + second, (name, gradient, difference, error)
        assert error < 0.1 * abs(gradient), (name, gradient, error)


@pytest.mark.long
@pytest.mark.parametrize(("depth", "change", "paths", "forward"),
                         [(ORDINARY, 0.02, 1 << 14, 1 << 17), (THICK, 0.01, 1 << 13, 1 << 17)])
def test_gradients_on_the_grid_agree_with_differences(make_constant_run, depth, change, paths, forward):
    """A thick medium's mean hardly follows the table: a step of 0.02 of it is as large as the table's entries
    themselves, and differences
    come out a seventh too small."""
    run = uneven(make_constant_run, depth)
    check(OnGrid(run), run.field_tensors(), change, paths, repeats=8, forward=forward)


@pytest.mark.long
def test_gradients_of_the_medium_agree_with_differences(make_constant_run):
    """At one depth: evaluating networks at every collision takes minutes."""
    run = uneven(make_constant_run, ORDINARY, grid_levels=2)
    check(Direct(run), run.field_tensors(), 0.03, 1 << 11, repeats=6, forward=1 << 15)
