"""Refuses captures whose body, masks and images do not belong together.

Two figures describe a view: the intersection over union (IoU) of the fitted body's silhouette and the mask,
and the share of the silhouette that lies on the mask. Clothes lower the first, not the second: a loose shirt
and trousers leave an IoU of 0.65 to 0.75, a coat or a long skirt one of 0.37 to 0.50, and all a share of 1.0.
Masks of other frames of the same motion have median values of 0.43 and 0.7 in loose clothes. In a coat they
have 0.35 and 0.86, and pass: a naked body cannot show that they are wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ndf_mi.capture.capture import Capture
from ndf_mi.capture.silhouette import Silhouettes
from ndf_mi.errors import InputError

#: A mask that covers more of its image than this shows no outline.
_FULL = 0.97
#: Least IoU of body and inverted mask for a mask that looks inverted.
_INVERTED = 0.3
#: Median IoU and share of the body below which, if both are, masks and body do not belong together.
_LEAST_IOU, _LEAST_ON_MASK = 0.5, 0.8
#: A view that has less of both than this, compared with the median view, shows something else.
_VIEW_IOU, _VIEW_ON_MASK = 0.7, 0.8
#: sRGB difference from the background from which a pixel shows something else.
_CLEAR = 0.06
#: Share of an image's border that must show the background for the image to be compared with its mask.
_BORDER = 0.9
#: Least share of what an image shows on the mask, or of the mask on what the image shows.
_MATCH = 0.7
#: Images that are compared with their masks before a training.
_IMAGES = 32


@dataclass(frozen=True)
class ViewAgreement:
    """How body and mask of a view agree.

    Attributes:
        file: of the mask.
        view: camera and frame, for messages.
        covered: share of the image that the mask covers.
        iou: intersection over union of body and mask.
        inverse_iou: the same of body and inverted mask.
        on_mask: share of the body's silhouette on the mask; NaN if the camera does not see the body.
    """

    file: Path
    view: str
    covered: float
    iou: float
    inverse_iou: float
    on_mask: float

    @classmethod
    def of(cls, file: Path, view: str, mask: np.ndarray, body: np.ndarray) -> ViewAgreement:
        """The figures of (h, w) bool mask and silhouette."""
        on_mask = float(mask[body].mean()) if body.any() else np.nan
        return cls(file, view, float(mask.mean()), _iou(mask, body), _iou(~mask, body), on_mask)

    @property
    def issue(self) -> InputError | None:
        """What is wrong with this mask by itself."""
        if self.covered > _FULL:
            return InputError(self.file, f"a mask that covers {self.covered:.0%} of the image ({self.view})",
                              f"at most {_FULL:.0%}: some background around the performer")
        if self.inverse_iou > max(_INVERTED, 2 * self.iou) and self.on_mask < 0.2:
            return InputError(
                self.file, f"{self.on_mask:.0%} of the fitted body on the mask ({self.view}), which covers "
                f"{self.covered:.0%} of the image", "255 on the performer and 0 elsewhere",
                "The mask looks inverted: swap 0 and 255.")
        return None


def mask_issues(views: Sequence[ViewAgreement], where: Path) -> list[InputError]:
    """What is wrong with the masks of a capture: one by one, of all together, or of some among good ones.

    Args:
        views: of the whole capture, or of its training images.
        where: the capture's folder.
    """
    found = [issue for view in views if (issue := view.issue) is not None]
    seen = [view for view in views if view.issue is None and np.isfinite(view.on_mask)]
    if not seen:
        return found
    iou, on_mask = (float(np.median([getattr(view, key) for view in seen])) for key in ("iou", "on_mask"))
    if iou < _LEAST_IOU and on_mask < _LEAST_ON_MASK:
        best = max(seen, key=lambda view: view.iou)
        found.append(InputError(
            where, f"masks that the fitted body does not fit: IoU {iou:.2f}, and {on_mask:.0%} of the body "
            f"on the mask (medians over {len(seen)} views; best IoU {best.iou:.2f}, {best.view})",
            f"an IoU of {_LEAST_IOU:g} or {_LEAST_ON_MASK:.0%} of the body on the mask",
            "Check that poses.npz, cameras and masks are of the same take and numbered alike, in metres and "
            "in OpenGL's axes."))
        return found
    for view in seen:
        if view.iou < _VIEW_IOU * iou and view.on_mask < _VIEW_ON_MASK * on_mask:
            found.append(InputError(
                view.file, f"a mask that the fitted body does not fit: IoU {view.iou:.2f}, and "
                f"{view.on_mask:.0%} of the body on it ({view.view})",
                f"about what other views have: IoU {iou:.2f}, {on_mask:.0%} (medians of {len(seen)})",
                "Check that the file is of this camera and frame, or leave the frame out of the splits."))
    return found


def image_issue(file: Path, image: np.ndarray, mask: np.ndarray, background: np.ndarray) -> InputError | None:
    """What is wrong with an image next to its mask; None if its border is not the background, which leaves
    nothing to compare.

    Args:
        file: of the image.
        image: (h, w, 3) sRGB.
        mask: (h, w) bool.
        background: (3,) sRGB.
    """
    other = np.abs(image - background).max(axis=-1) > _CLEAR
    border = np.concatenate([other[0], other[-1], other[:, 0], other[:, -1]])
    if border.mean() > 1 - _BORDER:
        return None
    if other.sum() < 0.01 * mask.sum():
        return InputError(file, "an image of the background only", "the performer where the mask is",
                          "Check `background` in capture.json, or replace the image.")
    # A mask cut too narrow holds only what differs; one of clothes in the background's colour holds all that.
    on_mask, differs = float(mask[other].mean()), float(other[mask].mean())
    if max(on_mask, differs) < _MATCH:
        return InputError(
            file, f"{on_mask:.0%} of what differs from the background on the mask, and {differs:.0%} of the "
            "mask that differs from the background", f"{_MATCH:.0%} of one or the other",
            "Image and mask look like those of different cameras or frames.")
    return None


def check_agreement(capture: Capture) -> None:
    """Compares body, masks and, of some views, images of the training split. Needs a Mitsuba variant.

    Raises:
        InputError: the first of the issues that ``ndf-mi capture check`` lists.
    """
    split = capture.splits["train"]
    silhouettes = Silhouettes(capture.body.faces, capture.poses.vertices.shape[1])
    step = max(1, -(-len(split) // _IMAGES))
    views: list[ViewAgreement] = []
    images: list[InputError | None] = []
    for frame in split.frames:
        silhouettes.pose(capture.poses.vertices[capture.poses.index(frame)])
        for name in split.cameras:
            image_file, mask_file = capture.files(name, frame)
            mask = capture.mask(name, frame)
            body = silhouettes.draw(capture.cameras[name])
            if len(views) % step == 0:
                images.append(image_issue(image_file, capture.image(name, frame), mask, capture.background))
            views.append(ViewAgreement.of(mask_file, f"camera {name}, frame {frame}", mask, body))
    for issue in [*mask_issues(views, capture.path), *filter(None, images)]:
        raise issue


def _iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two (h, w) bool; 0 if both are empty."""
    return float((a & b).sum()) / max(float((a | b).sum()), 1.0)
