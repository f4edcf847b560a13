"""Captures whose body, masks and images do not belong together are refused, with the file and the figure."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from ndf_mi.capture.agreement import ViewAgreement, check_agreement, image_issue, mask_issues
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.check import problems
from ndf_mi.capture.images import read_mask, write_image, write_mask
from ndf_mi.errors import InputError

SIZES = {"a": (40, 32), "b": (32, 48)}


def change_masks(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for name, size in SIZES.items():
        for file in (folder / "masks" / name).glob("*.png"):
            write_mask(file, change(read_mask(file, size)))


WRONG_MASKS = {
    "full": (lambda mask: np.ones_like(mask), "a mask that covers 100% of the image"),
    "inverted": (lambda mask: ~mask, "0% of the fitted body on the mask(.|\n)*inverted: swap 0 and 255"),
    "elsewhere": (lambda mask: np.roll(mask, mask.shape[1] // 3, 1),
                  "masks that the fitted body does not fit: IoU 0(.|\n)*of the same take"),
}


@pytest.mark.parametrize("case", WRONG_MASKS)
def test_wrong_masks_are_refused_before_training(box_capture: Path, case: str) -> None:
    change, message = WRONG_MASKS[case]
    check_agreement(Capture.read(box_capture))
    change_masks(box_capture, change)
    with pytest.raises(InputError, match=message):
        check_agreement(Capture.read(box_capture))


@pytest.mark.parametrize("case", ["full", "inverted"])
def test_the_check_of_a_capture_lists_them(box_capture: Path, case: str) -> None:
    change, message = WRONG_MASKS[case]
    change_masks(box_capture, change)
    found = "\n".join(map(str, problems(box_capture)))
    assert message.split("(")[0] in found and "masks/b/000001.png" in found


def test_clothes_that_stand_off_are_accepted(box_capture: Path) -> None:
    """30 cm on every side of a box 60 cm wide."""
    before = Capture.read(box_capture).mask("a", 0).sum()
    change_masks(box_capture, lambda mask: binary_dilation(mask, iterations=3))
    capture = Capture.read(box_capture)
    assert before / capture.mask("a", 0).sum() < 0.5
    check_agreement(capture)


def test_one_wrong_mask_among_good_ones_is_named() -> None:
    body = np.zeros((40, 40), bool)
    body[5:35, 15:22] = True
    views = [ViewAgreement.of(Path(f"masks/{i}.png"), f"camera c, frame {i}",
                              np.roll(body, 5 if i == 3 else 0, 1), body) for i in range(8)]
    (issue,) = mask_issues(views, Path("capture"))
    assert issue.where == "masks/3.png" and "camera c, frame 3" in issue.found and "IoU 0.17" in issue.found
    assert not mask_issues(views[:3], Path("capture"))


def test_images_of_something_else_are_named(box_capture: Path, tmp_path: Path) -> None:
    background, mask = np.array([0.25, 0.5, 0.75]), np.zeros((30, 30), bool)
    mask[5:25, 5:12] = True
    image = np.where(mask[..., None], [0.9, 0.2, 0.1], background)
    file = Path("image.png")
    assert image_issue(file, image, mask, background) is None
    assert image_issue(file, image, binary_dilation(mask, iterations=2), background) is None
    assert image_issue(file, np.random.default_rng(0).random(image.shape), mask, background) is None
    blank = np.broadcast_to(background, image.shape)
    assert "background only" in str(image_issue(file, blank, mask, background))
    shifted = image_issue(file, np.roll(image, 10, 1), mask, background)
    assert "0% of what differs from the background on the mask" in str(shifted)
    shutil.copytree(box_capture, tmp_path / "copy")
    write_image(tmp_path / "copy/images/a/000001.png", np.full((32, 40, 3), background))
    with pytest.raises(InputError, match=r"images/a/000001.png: found an image of the background only"):
        check_agreement(Capture.read(tmp_path / "copy"))
