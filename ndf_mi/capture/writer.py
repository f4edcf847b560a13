"""Writes a capture. ``capture.json`` comes last: a folder without it is not finished."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.capture.document import FILE_NAME, Document
from ndf_mi.capture.images import write_image, write_mask
from ndf_mi.files import write_json


class CaptureWriter:
    """Writes images and masks one by one; ``finish`` then writes the body, the poses and ``capture.json``,
    with ``document`` as its contents. The folder ``path`` is made when the first file is written."""

    def __init__(self, path: str | os.PathLike[str], document: Document) -> None:
        self.path = Path(path)
        self.document = document

    def has(self, camera: str, frame: int) -> bool:
        """Whether both the image and the mask exist; files are written atomically, and so are complete."""
        return all(file.is_file() for file in self.document.files(self.path, camera, frame))

    def write(self, camera: str, frame: int, image: np.ndarray, mask: np.ndarray) -> None:
        """Writes one image, (h, w, 3) sRGB float in [0, 1] or uint8, and its mask, (h, w) bool, or matte,
        float in [0, 1].

        Raises:
            ValueError: a shape is not the camera's.
        """
        of = self.document.cameras[camera]
        if image.shape != (of.h, of.w, 3) or mask.shape != (of.h, of.w):
            raise ValueError(f"camera {camera} is {of.h} x {of.w}, not {image.shape} with mask {mask.shape}")
        image_file, mask_file = self.document.files(self.path, camera, frame)
        write_image(image_file, image)
        write_mask(mask_file, mask)

    def finish(self, body: Body, poses: Poses) -> None:
        """Writes the body, the poses and finally ``capture.json``."""
        body.write(self.path / "body.npz")
        poses.write(self.path / "poses.npz")
        write_json(self.path / FILE_NAME, self.document.as_json())
