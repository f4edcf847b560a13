"""Chooses how to render an image: the best setting within a time, or the quickest one within an error."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.json_input import is_finite
from ndf_mi.render.cost import CostModel
from ndf_mi.render.image import Image
from ndf_mi.render.measure import pace
from ndf_mi.render.profile import Key, load_or_measure
from ndf_mi.render.ray_statistics import RayStatistics, probe
from ndf_mi.render.settings import Setting
from ndf_mi.run import QUADRATURE, Run
from ndf_mi.training_log import FILE_NAME, read_training_log

#: Samples per ray to choose from: multiples of four, the number of rounds, and no denser than budgets need,
#: because each number compiles its own kernels. Rays per pixel are always one: fields are trained through
#: pixel centres, and images of several rays are less accurate.
SAMPLES = (
    *range(4, 32, 4), *range(32, 64, 8), *range(64, 128, 16), *range(128, 256, 32), *range(256, 512, 64),
    *range(512, 1024, 64), *range(1024, 2048, 128), *range(2048, 4097, 256))
#: Relative error of a predicted time that is normal.
TOLERANCE = 0.2
#: Relative difference of the machine's pace from the profile's that is worth reporting.
PACE_CHANGE = 0.1
#: dB of loss that is not worth spending time on.
NEGLIGIBLE_LOSS = 0.01
#: Fraction of training rays drawn from the mask in runs that do not record it.
MASK_SHARE = 0.5

_TIMES = {"ms": 1e-3, "s": 1.0, "min": 60.0}


@dataclass(frozen=True)
class Choice:
    """A setting and its predicted time and error.

    Attributes:
        setting: what to render with.
        seconds: per image, once kernels are compiled.
        psnr: box PSNR in dB against the converged image of the same field.
        loss: dB of PSNR against photographs lost by not rendering to convergence; None where the field's own
            error is unknown.
        bound: the setting has more samples than any whose error was measured: `psnr` is a lower bound and
            `loss` an upper bound.
    """

    setting: Setting
    seconds: float
    psnr: float
    loss: float | None
    bound: bool = False

    def describe(self) -> str:
        """One sentence for people."""
        s = self.setting
        rays = "one ray" if s.spp == 1 else f"{s.spp} rays"
        least, most = ("at least ", "at most ") if self.bound else ("", "")
        loss = ""
        if self.loss is not None:
            loss = f", {most}{self.loss:.2g} dB below what the run reaches on photographs"
        return (
            f"{s.samples} samples per ray, {rays} per pixel, rays followed to a transmittance of "
            f"{s.cutoff:g}: expected to take {self.seconds:.3g} s, {least}{self.psnr:.1f} dB from "
            f"convergence{loss}")


def parse_seconds(text: str) -> float:
    """Seconds of a time such as ``0.5s``, ``300ms`` or ``2min``. Raises InputError for anything else."""
    return _parse("--budget", text, _TIMES, "a time above 0 such as 0.5s, 300ms or 2min")


def parse_decibel(text: str) -> float:
    """dB of a loss such as ``0.5dB``. Raises InputError for anything else."""
    return _parse("--error", text.lower(), {"db": 1.0}, "a loss above 0 such as 0.5dB")


def _parse(option: str, text: str, units: dict[str, float], expected: str) -> float:
    found = re.fullmatch(rf"\s*(\d+\.?\d*|\.\d+)\s*({'|'.join(units)})\s*", text)
    value = float(found[1]) * units[found[2]] if found else 0.0
    if not 0 < value < math.inf:
        raise InputError(option, repr(text), expected)
    return value


def training_error(run: Run, opacity: float) -> float | None:
    """The mean squared error in sRGB that a training ended with, over the pixels of the body's box.

    Logs of older versions do not separate the rays drawn from the box from those drawn from the mask. If a
    fraction s was drawn from the mask, nearly all of the error being on the performer, the error over all
    rays is (s + (1 − s) b) / b times that of the box.

    Args:
        opacity: b, the fraction of the box's pixels that the performer covers.

    Returns:
        The error, or None if the run was not trained by quadrature or its log does not contain it.
    """
    recorded = run.config.get("training")
    options = recorded if isinstance(recorded, dict) else {}
    if options.get("integrator", QUADRATURE) != QUADRATURE:
        return None
    last: dict[str, object] = next(reversed(read_training_log(run.path)), {})
    drawn, box, share = last.get("psnr"), last.get("box_psnr"), options.get("mask_share")
    if is_finite(box):
        return 10 ** (-box / 10)
    if not is_finite(drawn):
        return None
    s = share if is_finite(share) else MASK_SHARE
    return 10 ** (-drawn / 10) * (opacity / (s + (1 - s) * opacity) if opacity > 0 else 1)


def choose(
    run: Run, frame: int, camera: Camera, geometry: bool, report: Callable[[str], None], *,
    budget: float | None = None, error: float | None = None) -> Choice:
    """The best setting whose image takes `budget` seconds, or the quickest one that loses at most `error` dB.

    Args:
        run, frame, camera: what is rendered; a small version of the view is probed.
        geometry: whether (u, v, l) and normals are rendered as well.
        report: receives progress messages.
        budget, error: exactly one of them.

    Raises:
        InputError: no setting is within `budget` or `error`; or an error is asked for and the run's own
            error, which it is relative to, is unknown.
    """
    if error is not None and training_error(run, opacity=1.0) is None:
        raise InputError(
            run.path / FILE_NAME, "no final error of a training by quadrature",
            "one that --error can be relative to", "`--budget` works without it.")
    profile = load_or_measure(run, (camera.w, camera.h), geometry, report)
    own = training_error(run, profile.opacity)
    # An error does not depend on how fast the machine is now.
    slowdown = pace(run, (camera.w, camera.h), geometry, profile) if budget is not None else 1.0
    if not 1 / (1 + PACE_CHANGE) <= slowdown <= 1 + PACE_CHANGE:
        report(f"images take {slowdown:.2g} times as long now as when the profile was measured")
    choices = candidates(CostModel(profile.samples), probe(run.posed(frame), camera), own, slowdown)
    if error is not None:
        return within_error(choices, error)
    assert budget is not None
    best = within_budget(choices, budget)
    if best.setting.samples == SAMPLES[-1] and best.seconds < budget / (1 + TOLERANCE):
        report(f"more than {best.seconds:.3g} s does not improve an image of this size")
    enough = min((c for c in choices if c.psnr >= best.psnr), key=lambda c: c.seconds)
    if best.bound and enough.loss is not None and enough.loss < NEGLIGIBLE_LOSS:
        report(f"{enough.setting.samples} samples per ray take {enough.seconds:.3g} s and lose at most "
               f"{enough.loss:.2g} dB")
    return best


def candidates(
    model: CostModel, statistics: RayStatistics, own: float | None, slowdown: float = 1.0) -> list[Choice]:
    """Every setting on offer with its prediction: one ray per pixel, each of `SAMPLES`, each cutoff whose
    error is known.

    Args:
        own: mean squared error of the field itself against photographs, None if unknown. It adds to the
            rendering error, because the two are taken to be independent.
        slowdown: factor on the predicted times.
    """
    found = []
    for setting in (Setting(samples, cutoff) for cutoff in model.cutoffs for samples in SAMPLES):
        error = model.error(setting)
        loss = None if own is None else 10 * math.log10(1 + error / own)
        seconds, psnr = slowdown * model.seconds(setting, statistics), -10 * math.log10(error)
        found.append(Choice(setting, seconds, psnr, loss, model.beyond(setting)))
    return found


def within_budget(choices: Sequence[Choice], budget: float) -> Choice:
    """The most accurate choice that takes at most `budget` seconds; the one of most samples where errors were
    not measured.

    Raises:
        InputError: there is none; the message has the shortest time possible.
    """
    fitting = [choice for choice in choices if choice.seconds <= budget]
    if not fitting:
        least = min(choice.seconds for choice in choices)
        expected = f"at least {_round_up(least)} s for an image of this size on this machine"
        raise InputError("--budget", f"{budget:g} s", expected, "A smaller --size takes less.")
    return max(fitting, key=lambda c: (c.psnr, c.setting.samples * c.bound, -c.seconds))


def within_error(choices: Sequence[Choice], error: float) -> Choice:
    """The quickest choice that loses at most `error` dB.

    Raises:
        InputError: there is none; the message has the least loss possible.
    """
    fitting = [choice for choice in choices if choice.loss is not None and choice.loss <= error]
    if not fitting:
        least = min(choice.loss for choice in choices if choice.loss is not None)
        raise InputError("--error", f"{error:g} dB", f"at least {_round_up(least)} dB")
    return min(fitting, key=lambda choice: choice.seconds)


def render_choice(
    choice: Choice, run: Run, frame: int, camera: Camera, geometry: bool, report: Callable[[str], None],
    clock: Callable[[], float] = time.perf_counter) -> Image:
    """Renders the image and reports the time that it took. One that takes longer than expected by more than
    `TOLERANCE` has compiled kernels: it is rendered again, to report the time of every further frame."""
    times: list[float] = []
    for _ in range(2):
        start = clock()
        image = choice.setting.image(run, frame, camera, geometry)
        times.append(clock() - start)
        if times[-1] <= (1 + TOLERANCE) * choice.seconds:
            break
    compiling = f", and {times[0]:.3g} s the first time, which includes compiling" if len(times) > 1 else ""
    report(f"took {times[-1]:.3g} s{compiling}")
    ratio = times[-1] / choice.seconds
    if not 1 / (1 + TOLERANCE) <= ratio <= 1 + TOLERANCE:
        file = Key.of(run, (camera.w, camera.h), geometry).file
        report(
            f"that is {ratio:.2g} times the expected time: other programs are using the machine, or were "
            f"when the profile was measured. Remove {file} to measure it again.")
    return image


def _round_up(value: float) -> str:
    """Two significant digits, rounded up, so that asking for what is printed succeeds."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1) if value > 0 else 1.0
    return f"{math.ceil(value / step) * step:.2g}"
