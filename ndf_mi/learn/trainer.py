"""One training step after another: rays, gradients, Adam; and the state to go on from."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters
from ndf_mi.field.occupancy import Occupancy
from ndf_mi.learn.guard import Guard
from ndf_mi.learn.loss import ImageLoss
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.rays import RayBatch, RaySampler
from ndf_mi.learn.state import adam_tensors, read_state, restore_adam, write_state
from ndf_mi.model import PosedModel
from ndf_mi.render.quadrature import Radiance, quadrature
from ndf_mi.run import Run

STATE = "state.safetensors"
_SMOOTHING = 0.98

@dataclass(frozen=True)
class Progress:
    """Where training stands: steps done, seconds spent, smoothed mean squared error in sRGB of all rays drawn and of those drawn from the
    body's box alone (NaN without such rays, and through scattering), samples that reached the networks, steps refused because their
    gradients were not finite or the weights would not have been, and what that has left of the learning rates."""

    step: int
    seconds: float
    error: float
    box_error: float
    evaluated: int
    refused: int = 0
    rate_factor: float = 1.0

    @property
    def psnr(self) -> float:
        """−10·log10 of the error, in dB, on the rays drawn."""
        return -10 * math.log10(max(self.error, 1e-12))

    @property
    def box_psnr(self) -> float | None:
        """The same on the rays drawn from the body's box alone: on pixels as frequent as they are there."""
        return -10 * math.log10(max(self.box_error, 1e-12)) if math.isfinite(self.box_error) else None


@dataclass(frozen=True)
class Step:
    """What a step has found out: `loss`, one number that is not finite where the step cannot be taken; `error`, the mean squared error in
    sRGB of the rays drawn, one number, detached; `seen`, what the quadrature saw along them; `box`, the error of those drawn from the
    body's box, or None."""

    loss: mi.Float
    error: mi.Float
    seen: Radiance
    box: mi.Float | None = None


class Trainer:
    """Trains the field of `run` on the training split of `capture`: by quadrature, unless a subclass replaces :meth:`_gradients`.

    Weights live in the optimisers while training goes on; :meth:`publish` puts them into the run.
    """

    def __init__(self, run: Run, capture: Capture, options: TrainingOptions) -> None:
        self.run = run
        self.options = options
        self._rays = RaySampler(capture, capture.splits["train"], options)
        self._rng = np.random.default_rng([options.seed, 1])
        preset = run.model.field.preset
        self._candidates = options.rays * options.samples * preset.sample_factor
        self._loss = ImageLoss(options, mi.Color3f(*[float(v) for v in run.background]), preset.band, preset.density_gain)
        self._make_optimisers()
        # Two percent of opacity over a centimetre; what is never seen stays as thin as training starts, just below it.
        self._occupancy = Occupancy(threshold=2.0) if options.skip_empty else None
        self._step = 0
        self._seconds = 0.0
        self._error = self._box_error = float("nan")
        self._evaluated = 0
        self._rate = 0.0

    def _make_optimisers(self) -> None:
        """Fresh optimisers, without moments, of the weights that the run has, and a guard over them."""
        options, parameters = self.options, self.run.parameters
        self._networks = mi.ad.Adam(lr=options.learning_rate, params={"weights": parameters.weights})
        # Most entries of the table see no sample in a step: those keep their value and moments, as in the grid's paper.
        self._table = None
        if parameters.grid is not None:
            self._table = mi.ad.Adam(lr=options.grid_rate, params={"grid": parameters.grid}, mask_updates=True, epsilon=1e-15)
        self._guard = Guard([self._networks] if self._table is None else [self._networks, self._table])

    @property
    def progress(self) -> Progress:
        """Where training stands."""
        return Progress(self._step, self._seconds, self._error, self._box_error, self._evaluated, self._guard.refused, self._guard.factor)

    @property
    def parameters(self) -> FieldParameters:
        """The field's parameters as the optimisers have them now; their gradients are tracked."""
        return FieldParameters(self._networks["weights"], None if self._table is None else self._table["grid"])

    @property
    def done(self) -> float:
        """Share of the training that is done, in [0, 1]."""
        by_steps = self._step / self.options.steps
        by_clock = self._seconds / self.options.seconds if self.options.seconds > 0 else 0.0
        return min(1.0, max(by_steps, by_clock))

    def step(self) -> None:
        """Takes one step; where its gradients are not finite, or the weights would not be, goes back to the last state kept instead, with
        smaller rates.

        Raises:
            InputError: smaller rates have not helped.
        """
        started = time.perf_counter()
        self._set_rates()
        batch = self._rays(self._rng)
        found = self._gradients(batch)
        if not self._guard.sound(found.loss):
            self._guard.refuse(self._step + 1)
            self._seconds += time.perf_counter() - started
            return
        self._guard.proved(self._step)

        weights = self._networks["weights"]
        dr.set_grad(weights, dr.clip(dr.grad(weights), -self.options.clip, self.options.clip))
        self._networks.step()
        if self._table is not None:
            self._table.step()
        if not self._guard.landed(self._rate):
            self._guard.refuse(self._step + 1)
            self._seconds += time.perf_counter() - started
            return
        if self._occupancy is not None:
            samples = found.seen.samples
            at = self._posed.unit(mi.Point2f(samples.u.x, samples.u.y), samples.u.z)
            self._occupancy.observe(at, samples.sigma, found.seen.inside)
        dr.eval([value for value in (found.error, found.box) if value is not None])
        self._error = _smoothed(self._error, float(found.error[0]))
        self._box_error = float("nan") if found.box is None else _smoothed(self._box_error, float(found.box[0]))
        self._loss.observe(self._error)
        self._evaluated = found.seen.evaluated
        self._step += 1
        self._seconds += time.perf_counter() - started

    def _gradients(self, batch: RayBatch) -> Step:
        """The loss along a batch of rays; its gradients go to the optimisers' parameters."""
        seen = self._see(batch)
        loss = self._loss(seen, mi.Color3f(batch.target), mi.Float(batch.mask), mi.Float(batch.sure), mi.Float(batch.in_box))
        dr.backward(loss.total)
        return Step(loss.total, loss.image, seen, loss.box)

    def _see(self, batch: RayBatch) -> Radiance:
        """The field as it is now along a batch of rays, by quadrature, attached to the optimisers' parameters."""
        jitter = mi.Float(self._rng.random(self._candidates, dtype=np.float32))
        self._pose = self._noisy_pose(batch.frame)
        self._posed = PosedModel(self.run.model, self.parameters, self.run.surface(batch.frame), self._pose, self._occupancy)
        ray = mi.Ray3f(mi.Point3f(batch.origin), mi.Vector3f(batch.direction))
        return quadrature(self._posed, ray, self.options.samples, jitter=jitter, min_transmittance=self.options.skip_hidden)

    def publish(self) -> None:
        """Puts the current weights, detached, into the run's field."""
        self.run.parameters = self.parameters.detached()

    def save(self) -> None:
        """Writes the state to go on from, then the field."""
        tensors = adam_tensors(self._networks, "networks")
        if self._table is not None:
            tensors |= adam_tensors(self._table, "table")
        if self._occupancy is not None:
            tensors["occupancy"] = self._occupancy.values.numpy()
        facts: dict[str, Any] = {
            "step": self._step,
            "seconds": self._seconds,
            "error": None if math.isnan(self._error) else self._error,
            "box_error": None if math.isnan(self._box_error) else self._box_error,
            "rate_factor": self._guard.factor,
            "refused": self._guard.refused,
            "random": self._rng.bit_generator.state,
        }
        write_state(self.run.path / STATE, tensors, facts)
        self.publish()
        self.run.save_field()

    def restore(self) -> None:
        """Goes back to the state that :meth:`save` wrote last.

        Raises:
            InputError: there is none, or it does not fit the run's preset.
        """
        path = self.run.path / STATE
        tensors, facts = read_state(path)
        restore_adam(self._networks, "networks", tensors, str(path))
        if self._table is not None:
            restore_adam(self._table, "table", tensors, str(path))
        try:
            self._rng.bit_generator.state = facts["random"]
            self._step, self._seconds = int(facts["step"]), float(facts["seconds"])
            self._error = float("nan") if facts["error"] is None else float(facts["error"])
            # States written before it was told apart lack it.
            box = facts.get("box_error")
            self._box_error = float("nan") if box is None else float(box)
            # States written before rates could be made smaller, or before refused steps were counted, lack them.
            self._guard.factor = float(facts.get("rate_factor", 1.0))
            self._guard.refused = int(facts.get("refused", 0))
            self._guard.keep()
            if self._occupancy is not None:
                self._occupancy.restore(tensors["occupancy"], self._step)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(path, f"facts that are not a training state's ({error})", "what a checkpoint writes") from None
        if not math.isnan(self._error):
            self._loss.observe(self._error)
        self.publish()

    def _noisy_pose(self, frame: int) -> mi.Float:
        """The frame's pose vector as the networks see it in training: with noise on all joints but the root."""
        pose = self.run.poses.pose[self.run.poses.index(frame)].astype(np.float32)
        if self.options.pose_noise > 0:
            pose[1:] += self._rng.normal(0.0, self.options.pose_noise, pose[1:].shape).astype(np.float32)
        return mi.Float(pose.ravel())

    def _spent(self) -> float:
        """How much of the rates' decay is over, 1 when `decay` is reached."""
        return self._step / self.options.decay_steps if self.options.decay_steps else self.done

    def _set_rates(self) -> None:
        options = self.options
        spent = self._spent()
        factor = options.decay**spent * self._guard.factor
        self._rate = factor * max(options.learning_rate, options.grid_rate)
        self._networks.set_learning_rate(options.learning_rate * factor)
        if self._table is not None:
            self._table.set_learning_rate(options.grid_rate * factor)


def _smoothed(before: float, now: float) -> float:
    """The exponential moving average, which begins with its first value."""
    return now if math.isnan(before) else _SMOOTHING * before + (1 - _SMOOTHING) * now
