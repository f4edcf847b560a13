"""``ndf-mi capture import``: converts a capture from another layout."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ndf_mi.errors import InputError


@dataclass
class CaptureImport:
    """Convert a capture of ZJU-MoCap or DynaCap, undistorted and over black, with the frames and cameras of
    the published protocol; docs/captures-from-elsewhere.md describes the layouts. Nothing is written if there
    is an error."""

    layout: Annotated[Literal["zju", "dynacap"], tyro.conf.Positional]
    """The layout of DIR: a subject of ZJU-MoCap (CoreView_377), or a sequence of DynaCap."""
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The folder to read."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder of the new capture; it must be new or empty."""
    smpl: Path | None = None
    """SMPL's neutral model file, .pkl or .npz. Without it the body is only a mesh, whose triangles --uv
    gives."""
    uv: Path | None = None
    """Texture coordinates of SMPL's mesh: an .obj, or an .npz with uv, uv_faces and faces; by default one
    chart is made.
    """
    subject: str | None = None
    """The subject of ZJU-MoCap, 313 to 394; by default read from the folder's name."""
    fits: Literal["new_params", "params"] | None = None
    """The folder of fits: new_params (with pose blend shapes) or params (without); by default the first that
    exists.
    """
    frames: int = 1
    """Step between the frames of all splits."""
    test_frames: int = 30
    """Step between the frames of the held-out splits; a multiple of --frames."""
    train_cameras: tuple[str, ...] = ()
    """Names of the training cameras, instead of the protocol's."""
    test_cameras: tuple[str, ...] = ()
    """Names of the held-out cameras, instead of the protocol's."""
    scale: float = 0.5
    """Size of the new images relative to the original ones."""

    def run(self) -> int:
        """Converts the capture, with a progress bar."""
        from ndf_mi.capture.capture import Capture
        from ndf_mi.capture.check import summary
        from ndf_mi.capture.readers.dynacap import read_dynacap
        from ndf_mi.capture.readers.importing import import_capture
        from ndf_mi.capture.readers.source import Selection
        from ndf_mi.capture.readers.zju import read_zju
        from ndf_mi.commands.progress import image_bar

        selection = Selection(self.frames, self.test_frames, self.train_cameras, self.test_cameras)
        if self.layout == "zju":
            source = read_zju(self.path, self.subject, selection, self.fits)
        elif self.subject is not None:
            raise InputError("--subject", f"{self.subject} with the layout dynacap", "a subject only for zju")
        else:
            source = read_dynacap(self.path, selection, self.fits)
        with image_bar() as show:
            lines = import_capture(source, self.out, self.smpl, self.uv, self.scale, show)
        print("\n".join([summary(Capture.read(self.out)), *lines]))
        return 0
