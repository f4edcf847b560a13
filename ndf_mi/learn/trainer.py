"""Takes training steps: batch, loss, Adam, refusal of bad steps; saves and restores the state."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.field import FieldParameters
from ndf_mi.field.occupancy import Occupancy
from ndf_mi.learn.batch import Batch, BatchSampler
from ndf_mi.learn.best import Best
from ndf_mi.learn.corrections import GROUPS, Corrections
from ndf_mi.learn.guard import Guard
from ndf_mi.learn.held_back import EVERY, SHARE, TOLERANCE, HeldBackRays, choose_views
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.progress import Progress
from ndf_mi.learn.refined import registered_capture
from ndf_mi.learn.refinement import Refinement
from ndf_mi.learn.scattering import ScatteringStep, capture_lights
from ndf_mi.learn.state import adam_tensors, read_state, restore_adam, write_state
from ndf_mi.learn.step import QuadratureStep, Statistics, Step
from ndf_mi.run import QUADRATURE, Run

STATE = "state.safetensors"
_SMOOTHING = 0.98

#: Density in 1/m below which a cell counts as empty: 2 % opacity over a centimetre. Parts that no image shows
#: stay at the initial density, which is just below it.
_EMPTY = 2.0


class Trainer:
    """Trains the field of a run on the training split of a capture.

    With a scattering integrator the first `warm_up` steps are by quadrature, and those through scattering
    begin with fresh moments and keep the corrections of fit and colours. Parameters live in the optimisers;
    :meth:`publish` copies them to the run, or those that had the least error on held-back views, where there
    are some.

    Args:
        run: what to train.
        capture: the images.
        options: schedule, sampling and loss.
        spent: seconds of the training that went before; what this takes is added.

    Attributes:
        batches: draws a batch for each step, as :class:`BatchSampler`; can be replaced.
        optimisers: ``mi.ad.Adam`` by the name of the parameter that each updates: `weights`, `grid` where the
            preset has a hash table, and the groups of :class:`Corrections` that the options ask for.
        refinement: what the corrections do.

    Raises:
        InputError: the capture cannot be trained on with these options.
    """

    def __init__(self, run: Run, capture: Capture, options: TrainingOptions, spent: float = 0.0) -> None:
        started = time.perf_counter()
        self.run = run
        self.options = options
        self._frames = capture.splits["train"].frames
        capture = registered_capture(capture, run.surface_tensors)
        self.refinement = Refinement(run, capture, options)
        self._lights: dict[str, Any] = {}
        if options.integrator != QUADRATURE:
            self._lights = capture_lights(run, capture, options)
        split = capture.splits["train"]
        # Quadrature would measure something else than what steps through scattering improve.
        share = options.held_back if options.integrator == QUADRATURE else 0.0
        held_back = choose_views(len(split.frames), len(split.cameras), share, options.seed)
        self._sampler = BatchSampler(capture, options, run.model.field.preset.sample_factor,
                                     self.refinement.poses, held_back, run.model.field.preset.band)
        self.batches: Callable[[np.random.Generator, bool, bool], Batch] = self._sampler
        self._held_back = (HeldBackRays(run, capture, options, held_back, self.refinement.poses)
                           if held_back else None)
        self._best = Best()
        self._rng = np.random.default_rng([options.seed, 1])
        self._occupancy = Occupancy(threshold=_EMPTY) if options.skip_empty else None
        self._quadrature = QuadratureStep(run, options, self._occupancy, self.refinement)
        self._scattering_step: ScatteringStep | None = None
        self.optimisers: dict[str, Any] = {}
        self._make_optimisers()
        for name, value in self.refinement.initial().items():
            self.optimisers[name] = mi.ad.Adam(lr=self._base_rates()[name], params={name: value})
        self._guard = Guard(list(self.optimisers.values()))
        self._taken = 0
        self._scattering_begun = self.scattering
        # Images are read and masks weighed above.
        self._spent = self._seconds = spent + time.perf_counter() - started
        self._error = self._box_error = float("nan")
        self._evaluated = 0

    @property
    def progress(self) -> Progress:
        """How far the training has come."""
        best = self._best
        return Progress(self._taken, self._seconds, self._error, self._box_error, self._evaluated,
                        self._guard.steps_refused, self._guard.rate_factor, best.last, best.last_step,
                        best.step if best.parameters else None, best.error, best.released)

    @property
    def done(self) -> float:
        """Share of the training that is done, in [0, 1]."""
        by_steps = self._taken / self.options.steps
        # At least one step is taken, even if the time is over before it.
        by_clock = self._seconds / self.options.seconds if self.options.seconds > 0 and self._taken else 0.0
        return min(1.0, max(by_steps, by_clock))

    @property
    def scattering(self) -> bool:
        """Whether the next step is through scattering."""
        return self.options.integrator != QUADRATURE and self._taken >= self.options.warm_up

    @property
    def parameters(self) -> FieldParameters:
        """The current parameters, attached."""
        return FieldParameters(**{name: self.optimisers[name][name] for name in _FIELD
                                  if name in self.optimisers})

    @property
    def corrections(self) -> Corrections:
        """The current corrections of fit and colours; attached where the next step improves them."""
        values = {name: optimiser[name] for name, optimiser in self.optimisers.items() if name not in _FIELD}
        found = Corrections(**values)
        return found if self._refining else found.detached()

    @property
    def _refining(self) -> bool:
        return self._taken >= self.options.refine_after and not self.scattering

    def step(self) -> None:
        """Takes one step, or refuses it and returns to the last good state.

        Raises:
            InputError: too many steps were refused.
        """
        started = time.perf_counter()
        batch = self.batches(self._rng, self._error < self.options.edge_below, self.scattering)
        if self.scattering and not self._scattering_begun:
            self._begin_scattering()
        statistics = self._update(batch)
        if statistics is None:
            self._guard.refuse(self._taken + 1)
        else:
            self._record(statistics)
        self._seconds += time.perf_counter() - started
        if statistics is not None:
            # With this step's time, which may be the one that ends the training.
            self._measure_held_back()

    def publish(self) -> None:
        """Copies the parameters, detached, to the run, and the corrections to its fit: those with the least
        held-back error if it was measured, else the current ones."""
        kept = {name: values[name] for name, values in self._best.parameters.items()}
        if kept:
            self.run.parameters = FieldParameters(**{name: kept[name] for name in _FIELD if name in kept})
            corrections = Corrections(**{name: kept[name] for name in GROUPS if name in kept})
        else:
            self.run.parameters, corrections = self.parameters.detached(), self.corrections
        self.refinement.publish(corrections)

    def save(self) -> None:
        """Writes the training state, then the field and the fit."""
        self.refinement.save_initial()
        tensors: dict[str, np.ndarray] = {}
        for name, optimiser in self.optimisers.items():
            tensors |= adam_tensors(optimiser, _PREFIXES[name])
        if self._occupancy is not None:
            tensors["occupancy"] = self._occupancy.values.numpy()
        tensors |= self._best.tensors()
        metadata: dict[str, Any] = {
            "step": self._taken,
            "seconds": self._seconds,
            "spent": self._spent,
            "error": None if math.isnan(self._error) else self._error,
            "box_error": None if math.isnan(self._box_error) else self._box_error,
            "rate_factor": self._guard.rate_factor,
            "refused": self._guard.steps_refused,
            "random": self._rng.bit_generator.state,
            "best": self._best.metadata(),
        }
        write_state(self.run.path / STATE, tensors, metadata)
        self.publish()
        self.run.save_field()
        if self.corrections.groups():
            self.run.save_fit()

    def restore(self) -> None:
        """Returns to the state that :meth:`save` wrote last.

        Raises:
            InputError: there is none, or it does not fit the run's preset.
        """
        path = self.run.path / STATE
        tensors, metadata = read_state(path)
        for name, optimiser in self.optimisers.items():
            restore_adam(optimiser, _PREFIXES[name], tensors, str(path))
        try:
            self._rng.bit_generator.state = metadata["random"]
            self._taken, self._seconds = int(metadata["step"]), float(metadata["seconds"])
            self._error = _number(metadata["error"])
            # Older files lack these, and the best parameters.
            self._spent = float(metadata.get("spent", 0.0))
            self._box_error = _number(metadata.get("box_error"))
            self._guard.rate_factor = float(metadata.get("rate_factor", 1.0))
            self._guard.steps_refused = int(metadata.get("refused", 0))
            self._guard.snapshot()
            if "best" in metadata:
                self._best.restore(tensors, metadata["best"], self.optimisers, str(path))
                if self._best.released:
                    self._release()
            if self._occupancy is not None:
                self._occupancy.restore(tensors["occupancy"], self._taken)
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(path, f"metadata that is not a training state's ({error})",
                             "what a checkpoint writes") from None
        self._scattering_begun = self.scattering and self._taken > self.options.warm_up
        self.publish()

    def _make_optimisers(self) -> None:
        """Optimisers without moments, of the field's parameters in the run."""
        options, parameters = self.options, self.run.parameters
        self.optimisers["weights"] = mi.ad.Adam(lr=options.learning_rate,
                                                params={"weights": parameters.weights})
        if parameters.grid is not None:
            # Most entries of the table get no sample in a step. They keep value and moments (Müller et al.
            # 2022).
            self.optimisers["grid"] = mi.ad.Adam(lr=options.grid_rate, params={"grid": parameters.grid},
                                                 mask_updates=True, epsilon=1e-15)

    def _begin_scattering(self) -> None:
        self._scattering_begun = True
        self.publish()
        self._make_optimisers()
        self._guard.watch(list(self.optimisers.values()))
        self._error = float("nan")

    def _update(self, batch: Batch) -> Statistics | None:
        """Updates the parameters; None where the step must be refused."""
        rate = self._set_rates()
        loss, statistics = self._step()(self.parameters, batch, self.corrections)
        dr.backward(loss)
        if not self._guard.gradients_finite(loss):
            return None
        self._guard.mark_stable(self._taken)
        weights = self.optimisers["weights"]["weights"]
        dr.set_grad(weights, dr.clip(dr.grad(weights), -self.options.clip, self.options.clip))
        for name, optimiser in self.optimisers.items():
            if name in _FIELD or self._refining:
                optimiser.step()
        return statistics if self._guard.params_finite(rate) else None

    def _step(self) -> Step:
        if not self.scattering:
            return self._quadrature
        if self._scattering_step is None:
            self._scattering_step = ScatteringStep(self.run, self._frames, self._lights, self.options,
                                                   self._quadrature, self.refinement)
        return self._scattering_step

    def _record(self, statistics: Statistics) -> None:
        if self._occupancy is not None:
            self._occupancy.observe(statistics.places, statistics.densities, statistics.valid)
        error, box_error = statistics.error, statistics.box_error
        dr.eval([value for value in (error, box_error) if value is not None])
        self._error = _smoothed(self._error, float(error[0]))
        self._box_error = float("nan") if box_error is None else _smoothed(self._box_error,
                                                                           float(box_error[0]))
        self._evaluated = statistics.evaluated
        self._taken += 1

    def _measure_held_back(self) -> None:
        """Renders the held-back rays if it is time to, and keeps the parameters if they are the best."""
        if self._held_back is None:
            return
        started, done = time.perf_counter(), self.done
        if done >= 1 or (self._taken % EVERY == 0 and done - self._best.last_done >= 0.999 * SHARE):
            image_error = partial(self._quadrature.image_error, corrections=self.corrections)
            error = self._held_back.error(image_error, self.parameters)
            self._best.observe(self._taken, done, error, self.optimisers)
            if self.options.held_back_until <= done < 1 and error <= TOLERANCE * self._best.error:
                self._best.release()
                self._release()
            self._seconds += time.perf_counter() - started

    def _release(self) -> None:
        """Trains on the held-back views as well."""
        self._held_back = None
        self._sampler.release()

    def _set_rates(self) -> float:
        """Sets the optimisers' learning rates; returns the largest one."""
        factor = self.options.decay ** self._decay_progress() * self._guard.rate_factor
        rates = {name: rate * factor for name, rate in self._base_rates().items()}
        for name, optimiser in self.optimisers.items():
            optimiser.set_learning_rate(rates[name])
        return max(rates[name] for name in self.optimisers)

    def _base_rates(self) -> dict[str, float]:
        """The learning rates of the options, by parameter."""
        options = self.options
        return {"weights": options.learning_rate, "grid": options.grid_rate, "pose": options.pose_rate,
                "shape": options.shape_rate, "cameras": options.camera_rate, "colours": options.colour_rate}

    def _decay_progress(self) -> float:
        """How far the rates have decayed; 1 means by the factor `decay`. Warm-up and scattering each decay
        once, unless `decay_steps` or `seconds` set the decay."""
        options = self.options
        if options.decay_steps:
            return self._taken / options.decay_steps
        if options.seconds > 0:
            # From the first step on: what went before has taken no step.
            left = max(options.seconds - self._spent, 1e-9)
            by_clock = (self._seconds - self._spent) / left
            return min(1.0, max(self._taken / options.steps, by_clock))
        if options.integrator == QUADRATURE:
            return self.done
        if not self.scattering:
            return self._taken / options.warm_up
        return (self._taken - options.warm_up) / max(options.steps - options.warm_up, 1)


#: The parameters of the field; the others are corrections.
_FIELD = ("weights", "grid")

#: Names of the optimisers' tensors in the state file.
_PREFIXES = {"weights": "networks", "grid": "table"} | {name: name for name in GROUPS}


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _smoothed(before: float, now: float) -> float:
    """The exponential moving average, which begins with its first value."""
    return now if math.isnan(before) else _SMOOTHING * before + (1 - _SMOOTHING) * now
