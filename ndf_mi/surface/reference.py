"""The reference surface of a training: the body with vertex offsets that follow the performer's clothes and
hair, fitted to the training images before the field is.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.capture import Capture
from ndf_mi.errors import InputError
from ndf_mi.surface.offset_fit import OffsetFit
from ndf_mi.surface.rest_frames import RestFrames
from ndf_mi.surface.schedule import DEFAULT, Progress
from ndf_mi.surface.silhouettes import Silhouettes, agreement
from ndf_mi.surface.textured import TexturedSurface

TEXTURE = 128
"""Texels a side. The texture only has to keep colours from pulling at the surface."""

TEXTURE_RATE, OFFSET_RATE = 0.05, 0.02
"""Adam's first learning rate in sRGB units, and the first step of the offsets in metres."""

STEPS = 100
"""Steps without a time budget."""

MOST_FRAMES = 12
"""Training frames whose masks are compared with the surface."""


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
        agreement: mean intersection over union of the masks and the surface's silhouettes in training views.
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
                  progress: Progress | None = None) -> ReferenceSurface:
    """Fits vertex offsets to the capture's `train` split.

    Args:
        capture: with a `train` split.
        budget: wall-clock seconds to end by; None takes a fixed number of steps, which repeats exactly on
            the same machine.
        seed: of the order of frames and of the samples.
        progress: called after each step.

    Raises:
        InputError: the capture has no training images, or no camera sees the body.
    """
    start = time.perf_counter()
    rest = RestFrames(capture)
    fit = OffsetFit(TexturedSurface(capture, TEXTURE), rest, capture, TEXTURE, TEXTURE_RATE, OFFSET_RATE,
                    seed)
    steps, done = 0, 0.0
    while done < 1:
        fit.set_rate(DEFAULT.final_rate**done)
        loss = fit.step(steps)
        steps += 1
        seconds = time.perf_counter() - start
        done = steps / STEPS if budget is None else seconds / budget
        if progress is not None:
            progress(seconds, steps, loss)
    offsets = fit.offsets()
    body, poses = with_offsets(capture, rest, offsets)
    return ReferenceSurface(body, poses, offsets, np.zeros(len(offsets), np.float32),
                            mask_agreement(capture, poses.vertices), time.perf_counter() - start, steps)


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


def mask_agreement(capture: Capture, vertices: np.ndarray) -> float:
    """The mean intersection over union of the training masks and a surface's silhouettes.

    Args:
        vertices: (T, V, 3) of all frames of the capture's poses, metres.
    """
    split = capture.splits["train"]
    chosen = np.unique(np.linspace(0, len(split.frames) - 1, MOST_FRAMES).round().astype(int))
    caster = Silhouettes(capture.body.faces, vertices[0])
    silhouettes, masks = [], []
    for frame in (split.frames[i] for i in chosen):
        caster.set_vertices(vertices[capture.poses.index(frame)])
        for name in split.cameras:
            silhouettes.append(caster.silhouette(capture.cameras[name]))
            masks.append(capture.mask(name, frame))
    if not masks:
        raise InputError(f"{capture.path}: splits.train", "no cameras or no frames", "at least one of each")
    return agreement(silhouettes, masks)
