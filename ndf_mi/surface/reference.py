"""The reference surface of a training: the body with vertex offsets that follow the performer's clothes and
hair, fitted to the training masks before the field is trained.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.surface.outline_fit import OutlineFit
from ndf_mi.surface.outline_views import OutlineViews, Views
from ndf_mi.surface.rest_frames import RestFrames

Progress = Callable[[float, int, float], None]
"""See `fit_reference`."""

ROUNDS = 14
"""Rounds of the fit."""

LONGEST, SHORTEST = 0.1, 0.03
"""Metres over which the first and the last round move the surface smoothly."""

CHECKED_FRAMES = 12
"""Frames whose masks say how good the surface is; a third of them before the fit."""

ENDING = 4
"""What follows the rounds, the measuring and posing, takes this many times as long as what comes before
them.
"""

LEAST_OVERLAP = 0.2
"""Least agreement of the masks with the body before the fit. Inverted masks have 0.00, masks of the whole
image 0.08, a performer in loose clothes 0.68.
"""

LEAST_AGREEMENT = 0.75
"""Least agreement of the masks with the fitted surface. On the capture `quick`, masks of the next frame, of
another camera, mirrored or cut in half reach 0.47 to 0.68; masks that are right 0.98, 0.94 where 2 of their
pixels are missing all around, and 0.85 where every joint of the poses is off by 5 degrees. Masks that are
bounding boxes reach 0.82 and are not refused.
"""


@dataclass(frozen=True)
class ReferenceSurface:
    """A body with fitted offsets, posed in all frames of a capture.

    Attributes:
        body: the capture's body, with the offsets added to its template; unchanged without skinning.
        poses: all frames of the capture, with the offsets posed as by `RestFrames`: what `skin` makes of
            `body`.
        offsets: (V, 3) float32 metres, in the frames of `RestFrames`.
        residual: (V,) float32 metres, the root mean square distance in the training views between the
            masks' outlines and the surface's where the vertex is on the outline; smoothed over the surface,
            and interpolated where no view shows the vertex there.
        agreement: mean intersection over union of the masks and the fitted surface's silhouettes in training
            views, before offsets are shortened.
        seconds: wall-clock seconds of the fit.
        steps: steps of the fit.
    """

    body: Body
    poses: Poses
    offsets: np.ndarray
    residual: np.ndarray
    agreement: float
    seconds: float
    steps: int


def fit_reference(capture: Capture, budget: float | None = None, seed: int = 0,
                  progress: Progress | None = None, slack: float = 0.0) -> ReferenceSurface:
    """Fits vertex offsets to the capture's `train` split.

    Args:
        capture: with a `train` split.
        budget: wall-clock seconds to end by, within about a second, if the steps are not done before and the
            masks are met by then; None takes all steps, which repeats on the same machine.
        seed: of the order of frames and of the samples.
        progress: called after each step with the seconds and steps so far, and the share of the fit that is
            done, in (0, 1].
        slack: metres by which the fitted offsets are shortened, each as far as to zero at most.

    Raises:
        InputError: the capture has no training images, a mask cannot be read, or the masks do not show what
            the body was fitted to: the surface does not overlap with them enough.
    """
    start = time.perf_counter()
    rest, views = RestFrames(capture), OutlineViews(capture, seed)
    fit = OutlineFit(rest, capture.body.faces, seed)
    few = views.every(CHECKED_FRAMES // 3)
    if fit.agreement(few) < LEAST_OVERLAP:
        raise _not_found(capture, fit, few, None)
    begun = time.perf_counter() - start
    rounds_seconds = None if budget is None else max(budget - (1 + ENDING) * begun, 1e-6)
    steps, done = 0, 0.0
    while done < 1:
        fit.step(views.next(), LONGEST * (SHORTEST / LONGEST) ** done)
        steps, seconds = steps + 1, time.perf_counter() - start
        done = steps / ROUNDS
        if rounds_seconds is not None:
            done = max(done, (seconds - begun) / rounds_seconds)
        if progress is not None:
            progress(seconds, steps, min(done, 1))
    checked = views.every(CHECKED_FRAMES)
    agreement, residual = fit.check(checked)
    if agreement < LEAST_AGREEMENT and steps < ROUNDS:
        # Too little time is no sign of wrong masks: the rounds that are missing decide.
        for step in range(steps, ROUNDS):
            fit.step(views.next(), LONGEST * (SHORTEST / LONGEST) ** (step / ROUNDS))
        steps = ROUNDS
        agreement, residual = fit.check(checked)
    if agreement < LEAST_AGREEMENT:
        raise _not_found(capture, fit, checked, agreement)
    if slack > 0:
        fit.shorten(slack)
        _, residual = fit.check(checked)
    offsets = fit.offsets.astype(np.float32)
    body, poses = with_offsets(capture, rest, offsets)
    return ReferenceSurface(body, poses, offsets, residual.astype(np.float32), agreement,
                            time.perf_counter() - start, steps)


def with_offsets(capture: Capture, rest: RestFrames, offsets: np.ndarray) -> tuple[Body, Poses]:
    """The body with these offsets (V, 3), metres at rest, and its poses in all frames.

    The joints and the blend shapes stay the body's. Pose blend shapes move a vertex with its offset as they
    moved it without: they are added at rest, before skinning, so that `skin` of the new body agrees with the
    poses wherever `skin` of the old body did.
    """
    body, poses = capture.body, capture.poses
    vertices = np.stack([rest.posed(int(frame), offsets) for frame in poses.frames])
    if body.skinned:
        assert body.template is not None
        body = dataclasses.replace(body, template=body.template + offsets)
    return body, dataclasses.replace(poses, vertices=vertices)


def _not_found(capture: Capture, fit: OutlineFit, views: Views, fitted: float | None) -> InputError:
    """The error of masks that do not show the body; `fitted` is None before the fit."""
    if fitted is None:
        inverted = fit.agreement({frame: [(camera, 1 - matte) for camera, matte in seen]
                                  for frame, seen in views.items()})
        naked, least = fit.agreement(views), LEAST_OVERLAP
        found = f"silhouettes of the body and masks that overlap by {naked:.2f} (intersection over union)"
        if inverted > 0.5:
            found += f", and by {inverted:.2f} where the masks are inverted"
    else:
        least = LEAST_AGREEMENT
        found = (f"silhouettes and masks that overlap by {fitted:.2f} (intersection over union) after the "
                 "surface was fitted to them")
    return InputError(f"{capture.path}: splits.train", found,
                      f"an overlap of at least {least:g}: masks of the performer that the body was fitted to",
                      "Check that masks are 255 on the performer and 0 elsewhere, that the cameras' axes are "
                      "OpenGL's (x right, y up, looking along -z), and that images and poses have the same "
                      "frame numbers. Refine a fit that is off with --refine pose,cameras; or train around "
                      "the naked body with --option surface=body.")
