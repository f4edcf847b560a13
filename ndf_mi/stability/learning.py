"""Training: losses of black, white and bright images, learning rates of any size, pixels that are not numbers."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

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
from ndf_mi.learn.trainer import Trainer
from ndf_mi.render.quadrature import Radiance
from ndf_mi.stability.ball import RADIUS, charts, icosphere, looking
from ndf_mi.stability.case import Measured, case, error
from ndf_mi.stability.network64 import decode, encode

OPTIONS = TrainingOptions(steps=4, rays=64, samples=16, seed=3, pose_noise=0.0)
BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8
"""Of Adam; `mi.ad.Adam` takes ε² below the root with v."""


@contextmanager
def training(change: TrainingOptions, image: float = 0.5, lone: bool = False) -> Iterator[Trainer]:
    """A new training on a capture of a plain ball, seen by two cameras of 12 × 12 pixels; its mask is one pixel if `lone`."""
    vertices, faces = icosphere(1)
    uv, uv_faces = charts(len(faces))
    zeros = np.zeros((1, 3), np.float32)
    body = Body(faces, uv, uv_faces, template=vertices)
    poses = Poses(np.zeros(1, np.int32), vertices[None], np.zeros((1, 2, 3), np.float32), zeros, zeros)
    cameras = {}
    for name, way in (("a", [0.0, 0.1, 1.0]), ("b", [1.0, 0.2, 0.1])):
        view = np.array(way) / np.linalg.norm(way)
        cameras[name] = dataclasses.replace(looking(1.5 * view, -view, 12, 1.5), name=name)
    with tempfile.TemporaryDirectory() as folder:
        split = Split(tuple(cameras), (0,))
        document = Document(name="ball", background=(1.0, 1.0, 1.0), cameras=cameras, splits={"train": split})
        writer = CaptureWriter(Path(folder) / "capture", document)
        y, x = np.mgrid[:12, :12] + 0.5
        mask = np.hypot(x - 6, y - 6) < 12 * 1.5 * RADIUS / 1.5
        if lone:
            mask = (x == 6.5) & (y == 6.5)
        for name in cameras:
            writer.write(name, 0, np.where(mask[..., None], image, 1.0) * np.ones(3), mask)
        writer.finish(body, poses)
        tiny = dataclasses.replace(preset("tiny"), band_inside=0.08)
        yield start(Path(folder) / "run", Capture.read(writer.path), tiny, change)


def radiance(colour: np.ndarray, opacity: np.ndarray) -> Radiance:
    """What rays have seen, as a loss takes it; colours and opacities attached."""
    c, o = mi.Color3f(np.ascontiguousarray(colour.T, np.float32)), mi.Float(opacity.astype(np.float32))
    dr.enable_grad(c, o)
    return Radiance(c, o, mi.Float(0), None, None, None, mi.Bool(False), 0)  # type: ignore[arg-type]


@case("image losses of all black, all white and bright images, opacity and mask included",
      "linear values of 0, 1e-38 to 1e3; opacities 0, 1e-7, 1",
      relative_to="the value; gradients to the largest terms of a batch: colour and target, opacity and mask")
def losses() -> Iterator[Measured]:
    """The loss in sRGB over a background, and its derivatives in colour and opacity, written out."""
    options = dataclasses.replace(OPTIONS, edge_weight=0.0)
    rng = np.random.default_rng(10)
    for value in (0.0, 1e-38, 1e-20, 1e-7, 1e-3, 0.5, 1.0, 1 + 1e-6, 10.0, 1e3):
        for target, opaque in ((0.0, 1.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1e-7), (0.5, 0.5)):
            behind = np.array([0.2, 0.5, 1.0])
            opacity = np.full(9, opaque, np.float32)
            colour = (value * rng.uniform(0.9, 1, (9, 3))).astype(np.float32)
            mask = np.arange(9) % 2
            seen = radiance(colour, opacity)
            loss = ImageLoss(options, mi.Color3f(*map(float, behind)), 0.08, 100.0)
            total = loss(seen, mi.Color3f(target), mi.Float(mask), mi.Float(1.0)).total
            dr.backward(total)
            o = opacity.astype(np.float64)[:, None]
            back = decode(behind.astype(np.float32).astype(np.float64))
            composed = colour.astype(np.float64) + (1 - o) * back
            srgb = encode(composed)
            rise = np.where(composed <= 0.0031308, 12.92, 1.055 / 2.4 * np.maximum(composed, 1e-9) ** (1 / 2.4 - 1))
            off = srgb - target
            by_colour = 2 * off * rise / 27
            by_opacity = -(by_colour * back).sum(1) + 2 * options.opacity_weight * (o[:, 0] - mask) / 9
            truth = (off**2).mean() + options.opacity_weight * ((o[:, 0] - mask) ** 2).mean()
            # What their differences are made of: a colour less its target, an opacity less its mask.
            terms = 2 * (np.abs(srgb) + target) * rise / 27
            opacity_terms = (terms * back).sum(1) + 2 * options.opacity_weight * (o[:, 0] + mask) / 9
            yield Measured(f"{value:g} at opacity {opaque:g}, target {target:g}", error(float(total[0]), truth), max(
                error(dr.grad(seen.colour).numpy().T, by_colour, terms.max()),
                error(dr.grad(seen.opacity).numpy(), by_opacity, opacity_terms.max())))


@case("the loss of noisy estimates: of black, white and bright pixels", "linear values of 0, 1e-38 to 1e3",
      relative_to="the largest pair's product; derivatives to the largest")
def noisy_losses() -> Iterator[Measured]:
    """Each estimate times the others' mean error; what it returns for derivatives against the formula's."""
    rng = np.random.default_rng(11)
    for value in (0.0, 1e-38, 1e-20, 1e-7, 1e-3, 0.5, 1.0, 10.0, 1e3):
        for target in (0.0, 0.04, 1.0):
            estimates = (value * rng.uniform(0, 2, (5, 8, 3))).astype(np.float32)
            flat = mi.Color3f(np.ascontiguousarray(estimates.reshape(-1, 3).T))
            found, adjoint = NoisyLoss(8)(flat, mi.Color3f(dr.full(mi.Float, target, 5)))
            f = estimates.astype(np.float64)
            aim = float(decode(np.array(target, np.float32).astype(np.float64)))
            slope = 12.92 if aim <= 0.0031308 else 1.055 / 2.4 * aim ** (1 / 2.4 - 1)
            others = (f.sum(1, keepdims=True) - f) / 7
            terms = slope**2 * (f - aim) * (others - aim) / (3 * 40)
            by_estimate = 2 * slope**2 * (others - aim) / (3 * 40)
            yield Measured(f"{value:g}, target {target:g}", error(float(found[0]), terms.sum(), np.abs(terms).sum()), error(
                adjoint.numpy().T.reshape(5, 8, 3), by_estimate, np.abs(by_estimate).max()))


@case("learning rates: Adam's step, and weights that stay finite whatever it is", "1e-38 to 1e39, which float32 has not", gradient=None,
      relative_to="the weight and the rate", long=True)
def learning_rates() -> Iterator[Measured]:
    """The first step against Adam in float64 from the moments kept, and weights after all steps, which are those before where a step
    would overflow them: the step is refused, and the training ends with a message where smaller ones do not help."""
    for decade in (-38, -30, -20, -10, -3, 0, 3, 10, 20, 30, 36, 38, 39):
        rate = 10.0**decade
        with training(dataclasses.replace(OPTIONS, learning_rate=rate, grid_rate=rate)) as trainer:
            before = weights_of(trainer)
            trainer.step()
            after = weights_of(trainer)
            worst = 0.0
            if trainer.progress.steps_refused:
                worst = error(after, before)
            else:
                _, _, _, (_, m, v, _) = trainer.optimisers["weights"].state["weights"]
                first, second = (moment.numpy().astype(np.float64) for moment in (m, v))
                step = rate * np.sqrt(1 - BETA_2) / (1 - BETA_1) * first / np.sqrt(second + EPSILON**2)
                worst = error(after, before.astype(np.float64) - step, np.abs(before) + rate)
            try:
                while trainer.done < 1:
                    trainer.step()
                trainer.save()
            except InputError as stopped:
                worst = worst if "learning rate" in str(stopped) else np.inf
            trainer.publish()
            fine = all(np.isfinite(value).all() for value in trainer.run.field_tensors().values())
            yield Measured(f"1e{decade}", worst if fine else np.inf)


def weights_of(trainer: Trainer) -> np.ndarray:
    """The networks' weights as they are."""
    trainer.publish()
    return trainer.run.parameters.weights.numpy()


@case("a NaN in one pixel, one origin or one direction of a training's batch", "each in turn", gradient=None,
      relative_to="the largest of Adam's moments, those of a ray that misses; 0 for weights after a step that is refused")
def a_nan_in_a_batch() -> Iterator[Measured]:
    """A step whose loss is not a number is refused; a ray that is none sees nothing, and is trained towards what it should have seen."""
    _, missing, refused = _one_step("origin", 1e6)
    if refused:
        raise RuntimeError("a ray that misses was refused")
    for part in ("target", "origin", "direction", "mask"):
        weights, moments, refused = _one_step(part, np.nan)
        if part in ("target", "mask"):
            yield Measured(part, error(weights[1], weights[0], 0.0) if refused == 1 else np.inf)
        else:
            yield Measured(part, error(moments, missing, np.abs(missing).max())
                           if np.isfinite(weights[1]).all() and not refused else np.inf)


def _one_step(part: str, value: float) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray, int]:
    """Weights before and after a step in whose batch a ray has that value in a part, Adam's first moments, and how many steps were
    refused."""
    with training(OPTIONS) as trainer:
        draw = trainer.batches

        def broken(rng: np.random.Generator, edge_active: bool, scattering: bool) -> Batch:
            batch = draw(rng, edge_active, scattering)
            values = getattr(batch, part).copy()
            values[..., 5] = value
            return dataclasses.replace(batch, **{part: values})

        before = weights_of(trainer)
        trainer.batches = broken
        trainer.step()
        after = weights_of(trainer)
        # A refused step leaves no moments.
        kept = not trainer.progress.steps_refused
        moments = trainer.optimisers["weights"].state["weights"][3][1].numpy().astype(np.float64) if kept else np.zeros(0)
        return (before, after), moments, trainer.progress.steps_refused


@case("training on images all black and all white, and on masks of one pixel", "three steps each", primal=0.0, gradient=None,
      relative_to="no step is refused, and weights change")
def plain_captures() -> Iterator[Measured]:
    """Weights stay finite, and change."""
    for image, lone in ((0.0, False), (1.0, False), (0.0, True)):
        with training(OPTIONS, image, lone) as trainer:
            before = weights_of(trainer)
            for _ in range(3):
                trainer.step()
            after = weights_of(trainer)
            sound = np.isfinite(after).all() and (after != before).any() and not trainer.progress.steps_refused
            yield Measured(f"{'black' if image == 0 else 'white'}{', one pixel' if lone else ''}", 0.0 if sound else np.inf)
