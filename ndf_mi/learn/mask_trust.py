"""How far each pixel of the training masks is to be trusted.

Masks of recorded captures are off by pixels: cut too narrow or too wide, with holes, or with a neighbouring
object. A pixel loses trust where

1. the mask holds background, but the image shows something else than the capture's background;
2. the mask holds the performer, but the image shows the background, from the outline of the mask up to this
   pixel, and the fitted body is not there;
3. the mask holds the performer, but some other camera sees only background along the whole ray within reach
   of the body;
4. the mask holds background, but the fitted body is well inside its outline there, and the ray passes through
   a place that all other cameras see well inside their masks: weak evidence, since the fit may be off.

1 and 2 need images that show the capture's background: they are skipped in an image in which it cannot be
recognised away from the mask. 2 is also skipped where the performer wears the background's colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_propagation

from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.silhouette import Silhouettes
from ndf_mi.learn.visual_hull import grown, seen_by_others

#: sRGB difference from the background above which a pixel shows something else, unless it is noisy.
_CLEAR = 0.06
#: sRGB difference up to which a pixel shows the background, unless it is noisy.
_SAME = 2.5 / 255
#: Largest noise of a background that can be recognised: the 98th percentile of the difference.
_NOISE = 0.06
#: Share of the image's larger side around mask and body that is not used to measure that noise.
_AWAY = 0.04
#: Largest share of the body's pixels that may have the background's colour.
_CAMOUFLAGE = 0.1
#: Trust that is left where only weak evidence contradicts.
_WEAK = 0.25
#: Metres beyond the band within which other cameras are asked.
_BEYOND = 0.1
#: Pixels by which other cameras' masks are grown or shrunk before they may contradict.
_MARGIN = 2


class MaskTrust:
    """Weights of a capture's training masks. Needs a Mitsuba variant.

    Args:
        capture: the capture.
        band: metres around the reference surface where the field may be non-zero.
    """

    def __init__(self, capture: Capture, band: float) -> None:
        self._background = capture.background
        self._poses = capture.poses
        self._silhouettes = Silhouettes(capture.body.faces, capture.poses.vertices.shape[1])
        self._reach = band + _BEYOND

    def __call__(self, frame: int, vertices: np.ndarray, cameras: Sequence[Camera],
                 images: Sequence[np.ndarray], mattes: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The weights of one frame, (h, w) float32 in [0, 1] for each camera.

        Args:
            frame: its number.
            vertices: (V, 3) of the reference surface, in world space.
            cameras: that are trained on.
            images, mattes: of each camera.
        """
        self._silhouettes.pose(self._poses.vertices[self._poses.index(frame)])
        views = [TrustedView(camera, image, matte, self._silhouettes.draw(camera))
                 for camera, image, matte in zip(cameras, images, mattes, strict=True)]
        return mask_trust(views, self._background, vertices, self._reach)


@dataclass(frozen=True)
class TrustedView:
    """One training image and what is known of it.

    Attributes:
        camera: pinhole camera.
        image: (h, w, 3) sRGB in [0, 1].
        matte: (h, w) in [0, 1].
        body: (h, w) bool, the fitted body's silhouette.
    """

    camera: Camera
    image: np.ndarray
    matte: np.ndarray
    body: np.ndarray


def mask_trust(views: Sequence[TrustedView], background: np.ndarray, vertices: np.ndarray,
               reach: float) -> list[np.ndarray]:
    """Weights in [0, 1] for the mask pixels of one frame.

    Partly covered pixels and those next to the outline keep their full weight.

    Args:
        views: all training cameras' images of the frame.
        background: (3,) sRGB of the capture.
        vertices: (V, 3) the posed body.
        reach: metres around the body within which rays are followed.

    Returns:
        (h, w) float32 for each view.
    """
    evidence = [_ImageEvidence.of(view, background) for view in views]
    cameras, masks = [view.camera for view in views], [view.matte >= 0.5 for view in views]
    # Where the image shows more than the mask holds, the mask may be cut too narrow.
    widest = [grown(mask | found.other, _MARGIN) for mask, found in zip(masks, evidence, strict=True)]
    narrowest = [grown(mask, -_MARGIN) for mask in masks]
    possible = seen_by_others(cameras, widest, vertices, reach)
    likely = seen_by_others(cameras, narrowest, vertices, reach)
    trust = []
    for index, view in enumerate(views):
        mask, found = masks[index], evidence[index]
        outline = grown(mask, 1) & ~grown(mask, -1)
        contradicted = (~mask & found.other) | (mask & (found.same | ~possible[index]))
        weak = ~mask & likely[index] & grown(view.body, -_MARGIN)
        weight = np.where(contradicted, 0.0, np.where(weak, _WEAK, 1.0))
        soft = (view.matte > 0.1) & (view.matte < 0.9)
        trust.append(np.where(outline | soft, 1.0, weight).astype(np.float32))
    return trust


@dataclass(frozen=True)
class _ImageEvidence:
    """Pixels, (h, w) bool, outside of the mask that show something else than the background, and pixels of
    the mask that show the background up to the outline."""

    other: np.ndarray
    same: np.ndarray

    @classmethod
    def of(cls, view: TrustedView, background: np.ndarray) -> _ImageEvidence:
        mask = view.matte >= 0.5
        none = np.zeros(mask.shape, bool)
        difference = np.abs(view.image - background).max(axis=-1)
        away = difference[~grown(mask | view.body, round(_AWAY * max(mask.shape)))]
        # Without any background around the performer nothing is known of its noise.
        noise = float(np.quantile(away, 0.98)) if len(away) else np.inf
        if noise > _NOISE:
            return cls(none, none)
        other = ~mask & (difference > max(_CLEAR, 2 * noise))
        blank = difference <= max(_SAME, noise)
        inside = mask & grown(view.body, -_MARGIN)
        if not inside.any() or blank[inside].mean() > _CAMOUFLAGE:
            return cls(other, none)
        outer = binary_propagation(~mask, mask=blank | ~mask)
        return cls(other, mask & outer & ~grown(view.body, -_MARGIN))
