"""Measures how fast this machine renders a run, and how accurately: what a profile holds."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ndf_mi.body.box import padded_box
from ndf_mi.capture.camera import Camera, box_pixels, framing
from ndf_mi.render.cost import Sample
from ndf_mi.render.image import Work
from ndf_mi.render.settings import Setting, converged
from ndf_mi.run import Run

#: Longer side, in pixels, of the largest images measured. Times of larger images follow from their rays.
LARGEST = 512
CUTOFFS = (1e-4, 1e-2)
#: The setting that :func:`pace` renders again; every plan measures it at half size.
PACE = Setting(64, CUTOFFS[0])
#: A pace is clipped to between this and its inverse.
MAX_PACE = 4.0

Clock = Callable[[], float]


@dataclass(frozen=True)
class Plan:
    """What is measured.

    Attributes:
        half: settings measured at half of the width and height, with errors. With powers of two alone, the
            cost of padding could not be separated from that of samples.
        whole: settings measured at the whole width and height, without errors.
        azimuths: of the views, in degrees around the body; the frames are spread over the run's.
        repeats: timings of each image.
    """

    half: tuple[Setting, ...] = (
        *(Setting(n, CUTOFFS[0]) for n in (8, 16, 28, 64, 112, 256)),
        *(Setting(n, CUTOFFS[1]) for n in (8, 40, 128)))
    whole: tuple[Setting, ...] = (*(Setting(n, CUTOFFS[0]) for n in (16, 64, 224)), Setting(32, CUTOFFS[1]))
    azimuths: tuple[float, ...] = (0.0, 120.0)
    repeats: int = 3


FULL = Plan()


@dataclass(frozen=True)
class Profile:
    """Measurements of a run on a machine, one for each setting and size, and the mean opacity of the
    converged images over the pixels of the body's box: the fraction that the performer covers."""

    samples: list[Sample]
    opacity: float


@dataclass(frozen=True)
class _View:
    """A frame seen from an azimuth, at any size."""

    run: Run
    frame: int
    azimuth: float

    def camera(self, pixels: tuple[int, int]) -> Camera:
        return framing(self.run.poses.vertices[self.run.poses.index(self.frame)], *pixels, self.azimuth)

    def seconds(self, setting: Setting, pixels: tuple[int, int], geometry: bool, clock: Clock) -> float:
        camera = self.camera(pixels)
        start = clock()
        setting.image(self.run, self.frame, camera, geometry)
        return clock() - start


def measure(
    run: Run, size: tuple[int, int], geometry: bool, report: Callable[[str], None], plan: Plan = FULL,
    clock: Clock = time.perf_counter) -> Profile:
    """Measures settings in views of the run.

    A first pass compiles all kernels and finds the errors; the timings follow, in random order, so that a
    change of the machine's pace is spread over all settings.

    Args:
        size: width and height of the images that the profile is for.
        geometry: whether (u, v, l) and normals are rendered as well.
        report: receives progress messages.
        clock: seconds.
    """
    whole, half = _sizes(size)
    views = _views(run, plan.azimuths)
    jobs = [*((half, setting) for setting in plan.half), *((whole, setting) for setting in plan.whole)]
    works: list[list[Work]] = [[] for _ in jobs]
    errors: list[list[float]] = [[] for _ in jobs]
    opacities = []
    for number, view in enumerate(views, start=1):
        report(f"profile: compiling and measuring errors, view {number} of {len(views)}")
        camera = view.camera(half)
        truth = converged().image(run, view.frame, camera)
        mask = box_pixels(camera, *padded_box(run.poses.vertices[run.poses.index(view.frame)]))
        opacities.append(float(truth.opacity[mask].mean()) if mask.any() else 0.0)
        for index, (pixels, setting) in enumerate(jobs):
            image = setting.image(run, view.frame, view.camera(pixels), geometry)
            works[index].append(image.work)
            if index < len(plan.half) and mask.any():
                difference = image.over(run.background) - truth.over(run.background)
                errors[index].append(float(np.mean(np.square(difference)[mask])))
    seconds: list[list[list[float]]] = [[[] for _ in views] for _ in jobs]
    for repeat in range(plan.repeats):
        report(f"profile: timing, {repeat + 1} of {plan.repeats}")
        for number, view in enumerate(views):
            for index in np.random.default_rng([repeat, number]).permutation(len(jobs)):
                pixels, setting = jobs[index]
                seconds[index][number].append(view.seconds(setting, pixels, geometry, clock))
    samples = []
    for (_, setting), work, error, times in zip(jobs, works, errors, seconds, strict=True):
        counts = {name: statistics.mean(getattr(one, name) for one in work)
                  for name in ("tiles", "lanes", "evaluated", "launched")}
        mean_error = statistics.mean(error) if error else None
        mean_time = statistics.mean(map(statistics.median, times))
        samples.append(
            Sample(setting.samples, setting.cutoff, **counts, seconds=mean_time, error=mean_error))
    return Profile(samples, statistics.mean(opacities))


def pace(
    run: Run, size: tuple[int, int], geometry: bool, profile: Profile, plan: Plan = FULL,
    clock: Clock = time.perf_counter) -> float:
    """How many times as long rendering takes now as when the profile was measured; 1 if unknown.

    Processors, above all shared ones, do not keep one speed. Some of the profile's images are rendered again,
    in a second or two.
    """
    known = [
        s.seconds for s in profile.samples
        if (s.samples, s.cutoff) == (PACE.samples, PACE.cutoff) and s.error is not None]
    if not known:
        return 1.0
    medians = []
    for view in _views(run, plan.azimuths):
        # The first image may have to compile its kernels.
        times = [view.seconds(PACE, _sizes(size)[1], geometry, clock) for _ in range(1 + plan.repeats)]
        medians.append(statistics.median(times[1:]))
    return float(np.clip(statistics.mean(medians) / known[0], 1 / MAX_PACE, MAX_PACE))


def _sizes(size: tuple[int, int]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The larger and the smaller image size that are measured for a size."""
    shrink = min(LARGEST / max(size), 1.0)
    whole = (max(round(shrink * size[0]), 2), max(round(shrink * size[1]), 2))
    return whole, (max(whole[0] // 2, 1), max(whole[1] // 2, 1))


def _views(run: Run, azimuths: tuple[float, ...]) -> list[_View]:
    """A view for each azimuth, at frames spread over the run's."""
    frames, last = run.poses.frames, len(run.poses.frames) - 1
    steps = max(len(azimuths) - 1, 1)
    return [_View(run, int(frames[i * last // steps]), azimuth) for i, azimuth in enumerate(azimuths)]
