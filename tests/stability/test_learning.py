"""Training: losses of black and bright images, learning rates of any size, pixels that are not numbers."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.document import Document, Split
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.errors import InputError
from ndf_mi.field import preset
from ndf_mi.learn.batch import Batch
from ndf_mi.learn.loop import start
from ndf_mi.learn.loss import ImageLoss, NoisyLoss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.prepare import Reference
from ndf_mi.learn.trainer import Trainer
from ndf_mi.render.quadrature import Radiance
from ndf_mi.stability.ball import RADIUS, charts, icosphere, looking
from ndf_mi.stability.case import Check, case, error
from ndf_mi.stability.curves import decode, encode, encode_slope

OPTIONS = TrainingOptions(surface="body", steps=4, rays=64, samples=16, seed=3, pose_noise=0.0)
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam; `mi.ad.Adam` adds ε² to v under the root."""


@contextmanager
def training(options: TrainingOptions, image: float = 0.5, lone: bool = False) -> Iterator[Trainer]:
    """A training on two views of a ball, 12 × 12 pixels; if `lone`, the mask is one pixel."""
    vertices, faces = icosphere(1)
    zeros = np.zeros((1, 3), np.float32)
    body = Body(faces, *charts(len(faces)), template=vertices)
    poses = Poses(np.zeros(1, np.int32), vertices[None], np.zeros((1, 2, 3), np.float32), zeros, zeros)
    cameras = {}
    for name, way in (("a", [0.0, 0.1, 1.0]), ("b", [1.0, 0.2, 0.1])):
        view = np.array(way) / np.linalg.norm(way)
        cameras[name] = dataclasses.replace(looking(1.5 * view, -view, 12, 1.5), name=name)
    y, x = np.mgrid[:12, :12] + 0.5
    mask = (x == 6.5) & (y == 6.5) if lone else np.hypot(x - 6, y - 6) < 12 * RADIUS
    with tempfile.TemporaryDirectory() as folder:
        split = Split(tuple(cameras), (0,))
        document = Document(name="ball", background=(1.0, 1.0, 1.0), cameras=cameras, splits={"train": split})
        writer = CaptureWriter(Path(folder) / "capture", document)
        for name in cameras:
            writer.write(name, 0, np.where(mask[..., None], image, 1.0) * np.ones(3), mask)
        writer.finish(body, poses)
        tiny = dataclasses.replace(preset("tiny"), band_inside=0.08)
        # With a reference surface given, a mask that is nearly empty is not refused.
        yield start(Path(folder) / "run", Capture.read(writer.path), tiny, options,
                    surface=Reference(body, poses))


def weights_of(trainer: Trainer) -> np.ndarray:
    """The networks' current weights."""
    return trainer.parameters.weights.numpy()


def moments_of(trainer: Trainer) -> tuple[np.ndarray, np.ndarray]:
    """Adam's moments of the networks' weights."""
    _, first, second, _ = trainer.optimisers["weights"].state["weights"][3]
    return first.numpy().astype(np.float64), second.numpy().astype(np.float64)


def radiance(colour: np.ndarray, opacity: np.ndarray) -> Radiance:
    """What a loss takes of what rays have seen; colours and opacities are attached."""
    c, o = mi.Color3f(np.ascontiguousarray(colour.T, np.float32)), mi.Float(opacity.astype(np.float32))
    dr.enable_grad(c, o)
    return Radiance(c, o, mi.Float(0), None, None, None, mi.Bool(False), 0)  # type: ignore[arg-type]


@case("image losses of all black, all white and bright images, opacity and mask included",
      "linear values of 0, 1e-38 to 1e3; opacities 0, 1e-7, 1",
      relative_to="the value; gradients to the largest terms of a batch: colour and target, opacity and mask")
@pytest.mark.parametrize(("target", "opaque"), [(0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1e-7), (0.5, 0.5)],
                         ids=["black", "white", "clear", "almost clear", "half"])
@pytest.mark.parametrize(
    "value", [0.0, 1e-38, 1e-20, 1e-7, 1e-3, 0.5, 1.0, 1 + 1e-6, 10.0, 1e3], ids="{:g}".format)
def test_losses(check: Check, value: float, target: float, opaque: float) -> None:
    """The loss in sRGB over a background, and its derivatives in colour and opacity, by their formulas."""
    options = dataclasses.replace(OPTIONS, edge_weight=0.0)
    behind = np.array([0.2, 0.5, 1.0])
    opacity = np.full(9, opaque, np.float32)
    colour = (value * np.random.default_rng(10).uniform(0.9, 1, (9, 3))).astype(np.float32)
    mask = np.arange(9) % 2
    seen = radiance(colour, opacity)
    loss = ImageLoss(options, mi.Color3f(*map(float, behind)), 0.08, 100.0)
    total = loss(seen, mi.Color3f(target), mi.Float(mask), mi.Float(1.0)).total
    dr.backward(total)
    o = opacity.astype(np.float64)
    back = decode(behind.astype(np.float32).astype(np.float64))
    composed = colour.astype(np.float64) + (1 - o[:, None]) * back
    srgb, slope = encode(composed), encode_slope(composed)
    by_colour = 2 * (srgb - target) * slope / 27
    by_opacity = -(by_colour * back).sum(1) + 2 * options.opacity_weight * (o - mask) / 9
    truth = ((srgb - target) ** 2).mean() + options.opacity_weight * ((o - mask) ** 2).mean()
    # The differences are taken of these: a colour and its target, an opacity and its mask.
    terms = 2 * (np.abs(srgb) + target) * slope / 27
    opacity_terms = (terms * back).sum(1) + 2 * options.opacity_weight * (o + mask) / 9
    check(
        error(float(total[0]), truth),
        max(
            error(dr.grad(seen.colour).numpy().T, by_colour, terms.max()),
            error(dr.grad(seen.opacity).numpy(), by_opacity, opacity_terms.max())),
    )


@case("the loss of noisy estimates: of black, white and bright pixels", "linear values of 0, 1e-38 to 1e3",
      relative_to="the largest pair's product; derivatives to the largest")
@pytest.mark.parametrize("target", [0.0, 0.04, 1.0], ids="target {:g}".format)
@pytest.mark.parametrize("value", [0.0, 1e-38, 1e-20, 1e-7, 1e-3, 0.5, 1.0, 10.0, 1e3], ids="{:g}".format)
def test_noisy_losses(check: Check, value: float, target: float) -> None:
    """Each estimate times the mean error of the others; the derivatives returned, by the formula."""
    estimates = (value * np.random.default_rng(11).uniform(0, 2, (5, 8, 3))).astype(np.float32)
    flat = mi.Color3f(np.ascontiguousarray(estimates.reshape(-1, 3).T))
    found, adjoint = NoisyLoss(8)(flat, mi.Color3f(dr.full(mi.Float, target, 5)))
    f = estimates.astype(np.float64)
    aim = decode(np.array(target, np.float32).astype(np.float64))
    factor = encode_slope(aim) ** 2 / (3 * 40)
    others = (f.sum(1, keepdims=True) - f) / 7
    terms = factor * (f - aim) * (others - aim)
    by_estimate = 2 * factor * (others - aim)
    check(error(float(found[0]), terms.sum(), np.abs(terms).sum()),
          error(adjoint.numpy().T.reshape(5, 8, 3), by_estimate, np.abs(by_estimate).max()))


@pytest.mark.long
@case(
    "learning rates: Adam's step, and weights that stay finite at any rate",
    "1e-38 to 1e39, which is beyond float32", gradient=None, relative_to="the weight and the rate")
@pytest.mark.parametrize("decade", [-38, -30, -20, -10, -3, 0, 3, 10, 20, 30, 36, 38, 39], ids="1e{}".format)
def test_learning_rates(check: Check, decade: int) -> None:
    """The first step against Adam in float64, from the moments kept. A step that would overflow the weights
    is refused and leaves them; where smaller rates do not help, the training ends with a message."""
    rate = 10.0**decade
    with training(dataclasses.replace(OPTIONS, learning_rate=rate, grid_rate=rate)) as trainer:
        before = weights_of(trainer)
        trainer.step()
        expected = before.astype(np.float64)
        if not trainer.progress.steps_refused:
            first, second = moments_of(trainer)
            expected -= rate * np.sqrt(1 - BETA_2) / (1 - BETA_1) * first / np.sqrt(second + EPSILON**2)
        off = error(
            weights_of(trainer), expected, np.abs(before) + (0 if trainer.progress.steps_refused else rate))
        try:
            while trainer.done < 1:
                trainer.step()
            trainer.save()
        except InputError as stopped:
            assert "learning rate" in str(stopped)
        trainer.publish()
        assert all(np.isfinite(value).all() for value in trainer.run.field_tensors().values())
    check(off)


def one_step(part: str, value: float) -> tuple[Trainer, np.ndarray, np.ndarray]:
    """A training after one step with `value` in a part of one ray; the weights before and after it."""
    with training(OPTIONS) as trainer:
        draw = trainer.batches

        def broken(*arguments: object) -> Batch:
            batch = draw(*arguments)  # type: ignore[arg-type]
            values = getattr(batch, part).copy()
            values[..., 5] = value
            return dataclasses.replace(batch, **{part: values})

        before = weights_of(trainer)
        trainer.batches = broken
        trainer.step()
        return trainer, before, weights_of(trainer)


NAN = case(
    "a NaN in one pixel, one origin or one direction of a training's batch", "each in turn", gradient=None,
    relative_to="the largest of Adam's moments, those of a ray that misses; 0 for weights after a step that "
    "is refused")


@NAN
@pytest.mark.parametrize("part", ["target", "mask"])
def test_a_nan_in_a_batch(check: Check, part: str) -> None:
    """A step whose loss is not a number is refused."""
    trainer, before, after = one_step(part, np.nan)
    assert trainer.progress.steps_refused == 1
    check(error(after, before, 0.0))


@NAN
@pytest.mark.parametrize("part", ["origin", "direction"])
def test_a_nan_in_a_ray(check: Check, part: str) -> None:
    """A ray that is not a number sees nothing, and is trained towards what it should have seen."""
    (missing, _, _), (trainer, _, after) = one_step("origin", 1e6), one_step(part, np.nan)
    assert (
        not missing.progress.steps_refused and not trainer.progress.steps_refused and np.isfinite(after).all()
    )
    expected = moments_of(missing)[0]
    check(error(moments_of(trainer)[0], expected, np.abs(expected).max()))


@case(
    "training on images all black and all white, and on masks of one pixel", "three steps each", primal=0.0,
    gradient=None, relative_to="no step is refused, and weights change")
@pytest.mark.parametrize(
    ("image", "lone"), [(0.0, False), (1.0, False), (0.0, True)], ids=["black", "white", "black, one pixel"])
def test_plain_captures(check: Check, image: float, lone: bool) -> None:
    with training(OPTIONS, image, lone) as trainer:
        before = weights_of(trainer)
        for _ in range(3):
            trainer.step()
        after = weights_of(trainer)
    assert np.isfinite(after).all() and (after != before).any()
    check(float(trainer.progress.steps_refused))
