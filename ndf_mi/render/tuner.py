"""Choosing how to draw a picture: the best one in a time, or the quickest one within an error."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.json_input import is_finite
from ndf_mi.learn.options import TrainingOptions
from ndf_mi.learn.scattering import QUADRATURE
from ndf_mi.render.cost import CostModel
from ndf_mi.render.image import Image
from ndf_mi.render.profile import Key, pace, profile_of
from ndf_mi.render.ray_statistics import look
from ndf_mi.render.settings import Setting
from ndf_mi.run import Run
from ndf_mi.training_log import read_training_log

#: Samples a ray that are offered: multiples of four, which is how many rounds a ray is looked at in, and no more than times need to be met
#: closely, since each number compiles kernels of its own. Never more rays a pixel: fields are trained through pixels' centres, and
#: pictures of several rays are further from the truth.
SAMPLES = (*range(4, 32, 4), *range(32, 64, 8), *range(64, 128, 16), *range(128, 256, 32), *range(256, 512, 64), *range(512, 1024, 64),
           *range(1024, 2048, 128), *range(2048, 4097, 256))
#: How far off the time asked for a picture may be.
TOLERANCE = 0.2
#: How far off the profile's a pace is worth a word.
PACE_TOLD = 0.1
#: dB of loss below which it is told that more time buys next to nothing.
TOLD = 0.01

_UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0}


@dataclass(frozen=True)
class Choice:
    """A setting, and what is believed of it.

    Attributes:
        setting: what to draw with.
        seconds: that a picture takes, its kernels compiled.
        psnr: box PSNR in dB against the same field drawn to convergence.
        loss: dB of PSNR against the truth that it gives up to that; None where the field's own error is not known.
        bound: whether errors of so many samples were not measured, and `psnr` and `loss` are those of the most that were: the one at least
            so large, the other at most.
    """

    setting: Setting
    seconds: float
    psnr: float
    loss: float | None
    bound: bool = False

    def told(self) -> str:
        """For people, in one sentence."""
        s = self.setting
        rays = "one ray" if s.spp == 1 else f"{s.spp} rays"
        least, most = ("at least ", "at most ") if self.bound else ("", "")
        given = "" if self.loss is None else f", {most}{self.loss:.2g} dB of what it reaches against the truth given up"
        return (f"{s.samples} samples a ray, {rays} a pixel, rays followed to a transmittance of {s.cutoff:g}: believed to take "
                f"{self.seconds:.3g} s, {least}{self.psnr:.1f} dB from convergence{given}")


def parse_seconds(text: str) -> float:
    """Seconds of a time such as ``0.5s``, ``300ms`` or ``2min``. Raises InputError for anything else."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*(ms|s|min)\s*", text)
    value = float(found[1]) * _UNITS[found[2]] if found else 0.0
    if not 0 < value < math.inf:
        raise InputError("--budget", repr(text), "a time above 0 such as 0.5s, 300ms or 2min")
    return value


def parse_decibel(text: str) -> float:
    """dB of a loss such as ``0.5dB``. Raises InputError for anything else."""
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*dB\s*", text, re.IGNORECASE)
    value = float(found[1]) if found else 0.0
    if not 0 < value < math.inf:
        raise InputError("--error", repr(text), "a loss above 0 such as 0.5dB")
    return value


@dataclass(frozen=True)
class Ended:
    """The mean squared errors in sRGB that a training ended with, of its rays.

    Attributes:
        drawn: of all of them; None where those of the box are known.
        box: of those drawn from the body's box, as pictures' errors are; None where the log does not tell them apart.
        mask_share: the share of rays that were drawn from the mask's pixels.
    """

    drawn: float | None
    box: float | None
    mask_share: float

    def own(self, opacity: float) -> float:
        """The error over the pixels of the body's box, of which the performer fills the share `opacity`.

        Of rays that are not told apart a share s is of the mask, the others of the box, of which b is mask: the error is larger than the
        box's by (s + (1 − s) b) / b where all of it is on the performer, as nearly all of it is.
        """
        if self.box is not None:
            return self.box
        assert self.drawn is not None
        s = self.mask_share
        return self.drawn * opacity / (s + (1 - s) * opacity) if opacity > 0 else self.drawn


def ended(run: Run) -> Ended | None:
    """What a run's training ended with, by its log; None where it says nothing, or the run was not trained by quadrature."""
    known = run.config.get("training")
    training = known if isinstance(known, dict) else {}
    usual = TrainingOptions()
    history = read_training_log(run.path) if training.get("integrator", usual.integrator) == QUADRATURE else []
    drawn, box = (_error(history[-1].get(key)) if history else None for key in ("psnr", "box_psnr"))
    share = training.get("mask_share", usual.mask_share)
    return None if drawn is None and box is None else Ended(drawn, box, share if is_finite(share) else usual.mask_share)


def _error(psnr: object) -> float | None:
    return 10 ** (-psnr / 10) if is_finite(psnr) else None


def choose(run: Run, frame: int, camera: Camera, geometry: bool, tell: Callable[[str], None], *, budget: float | None = None,
           error: float | None = None) -> Choice:
    """The best setting whose picture takes `budget` seconds, or the quickest that gives up no more than `error` dB.

    Args:
        run, frame, camera: what is drawn; the view is looked at, small, for what its rays meet.
        geometry: whether (u, v, l) and normals are drawn, too.
        tell: told what is being done.
        budget, error: one of them.

    Raises:
        InputError: the quickest picture takes longer than `budget`, no setting is within `error`, or the run's own error, which that is
            relative to, is not known.
    """
    known = ended(run)
    if error is not None and known is None:
        raise InputError(f"{run.path / 'metrics.jsonl'}", "no error that a training by quadrature ended with",
                         "one, for --error to be relative to", "`--budget` needs none.")
    profile = profile_of(run, (camera.w, camera.h), geometry, tell)
    own = None if known is None else known.own(profile.opacity)
    model = profile.model()
    sight = look(run.posed(frame), camera)
    # An error asks for no time: what pictures take now is told, and decides nothing.
    slower = pace(run, (camera.w, camera.h), geometry, profile) if budget is not None else 1.0
    if not 1 / (1 + PACE_TOLD) <= slower <= 1 + PACE_TOLD:
        tell(f"pictures take {slower:.2g} times as long now as when the profile was measured")
    found = [Choice(setting, slower * model.seconds(setting, sight), *_believed(model.error(setting), own), model.beyond(setting))
             for setting in offered(model)]
    if budget is not None:
        best = within_budget(found, budget)
        if best.setting.samples == SAMPLES[-1] and best.seconds < budget / (1 + TOLERANCE):
            tell(f"more than {best.seconds:.3g} s buy nothing at this size")
        enough = min((c for c in found if c.psnr >= best.psnr), key=lambda c: c.seconds)
        if best.bound and enough.loss is not None and enough.loss < TOLD:
            tell(f"all but {enough.loss:.2g} dB of it is there after {enough.seconds:.3g} s, with {enough.setting.samples} samples a ray")
        return best
    assert error is not None
    return within_error(found, error)


def drawn_in_time(choice: Choice, run: Run, frame: int, camera: Camera, geometry: bool, tell: Callable[[str], None]) -> Image:
    """The picture, and what it took. One that took longer than believed by more than `TOLERANCE` has compiled kernels: it is drawn again,
    so that what is told is what another frame takes."""
    taken: list[float] = []
    for _ in range(2):
        begun = time.perf_counter()
        image = choice.setting.image(run, frame, camera, geometry)
        taken.append(time.perf_counter() - begun)
        if taken[-1] <= (1 + TOLERANCE) * choice.seconds:
            break
    compiling = f", and {taken[0]:.3g} s the first time, with compiling" if len(taken) > 1 else ""
    tell(f"took {taken[-1]:.3g} s{compiling}")
    off = taken[-1] / choice.seconds
    if not 1 / (1 + TOLERANCE) <= off <= 1 + TOLERANCE:
        kept = Key.of(run, (camera.w, camera.h), geometry).file
        tell(f"that is {off:.2g} times what was believed: the machine is busy, or was when it was measured. Remove {kept} to measure "
             "it anew.")
    return image


def within_budget(choices: list[Choice], budget: float) -> Choice:
    """The one of least error among those that fit, and of most samples where errors were not measured. Raises InputError, with the least
    time there is, where none fits."""
    fitting = [choice for choice in choices if choice.seconds <= budget]
    if not fitting:
        least = min(choices, key=lambda choice: choice.seconds)
        raise InputError("--budget", f"{budget:g} s", f"at least {_up(least.seconds)} s for a picture of this size on this machine",
                         "A smaller --size takes less.")
    return max(fitting, key=lambda c: (c.psnr, c.setting.samples * c.bound, -c.seconds))


def within_error(choices: list[Choice], error: float) -> Choice:
    """The quickest one among those that give up no more. Raises InputError, with the least loss there is, where none does."""
    fitting = [choice for choice in choices if choice.loss is not None and choice.loss <= error]
    if not fitting:
        least = min(choice.loss for choice in choices if choice.loss is not None)
        raise InputError("--error", f"{error:g} dB", f"at least {_up(least)} dB")
    return min(fitting, key=lambda choice: choice.seconds)


def offered(model: CostModel) -> Iterator[Setting]:
    """What a picture may be drawn with: one ray a pixel, any of the samples, each early termination whose error is known."""
    return (Setting(samples, cutoff) for cutoff in model.cutoffs for samples in SAMPLES)


def _believed(error: float, own: float | None) -> tuple[float, float | None]:
    """PSNR against convergence, and the loss against the truth: errors of rendering and of the model are taken as independent."""
    return -10 * math.log10(error), None if own is None else 10 * math.log10(1 + error / own)


def _up(value: float) -> str:
    """Two digits, rounded up: what is said to suffice does."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1) if value > 0 else 1.0
    return f"{math.ceil(value / step) * step:.2g}"
