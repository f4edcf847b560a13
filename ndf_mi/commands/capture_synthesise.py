"""``ndf-mi capture synthesise``: makes a capture of a synthetic performer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass
class CaptureSynthesise:
    """Make a capture of a synthetic, dressed performer, path traced; goes on where it was stopped."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """The folder to make: new, empty, or one in which this command was stopped."""
    size: Literal["tiny", "plan", "lit", "quick", "studio"] = "quick"
    """tiny (48 pixels, for tests), plan (80 pixels, 12 frames, for studies of `ndf-mi plan`), lit (96 pixels, 3 frames, for relighting),
    quick (128 pixels, about a minute on two cores) or studio (256 pixels, 21 cameras)."""
    light: Literal["studio", "evening", "carried", "flat"] = "studio"
    """What the performer is lit by; captures with different lights and otherwise the same options differ in it alone. carried: the studio's
    light, turning with the performer; flat: none, surfaces show their reflectance. Of these two, the capture does not say its light."""
    motion: Literal["clips", "turn", "still"] = "clips"
    """clips: walking and climbing; turn: one pose, turned around once over the frames; still: one pose that never moves."""
    clothes: Literal["loose", "tight"] = "loose"
    """loose clothes stand off by centimetres; tight ones lie within 12 mm of the body, and the head is shaved."""
    folds: bool = True
    """Whether cloth folds with the pose."""
    surface: Literal["mixed", "matte", "glossy"] = "mixed"
    """mixed: diffuse cloth, glossy skin, hair and shoes; matte: all of it diffuse; glossy: all of it shines."""
    seed: int = 0
    """Seed of the cameras' placement and of the renderer; the same seed makes the same capture."""
    name: str = "performer"
    """The capture's name."""
    pixels: int | None = None
    """Width and height of the images, instead of the size's."""
    spp: int | None = None
    """Samples a pixel, instead of the size's."""
    cameras: int | None = None
    """Cameras in the ring, instead of the size's."""
    frames: int | None = None
    """Training frames, instead of the size's."""
    pose_frames: int | None = None
    """Frames of novel poses, instead of the size's."""
    overwrite: bool = False
    """Make anew what is in OUT, where that is a capture."""

    def run(self) -> int:
        """Makes the capture, with a progress bar."""
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        from ndf_mi import variants
        from ndf_mi.capture.synthesise import plan

        named = ("seed", "pixels", "spp", "cameras", "frames", "pose_frames")
        given = {key: getattr(self, key) for key in named if getattr(self, key) is not None}
        settings = plan.SIZES[self.size]
        if self.frames is not None:
            given["view_frames"] = min(settings.view_frames, self.frames)
        if self.cameras is not None:
            given["train_cameras"] = train = min(settings.train_cameras, self.cameras)
            given["pose_cameras"] = min(settings.pose_cameras, self.cameras - train or self.cameras)
        settings = replace(settings, **given)
        variants.use()
        from ndf_mi.capture.synthesise.look import Look
        from ndf_mi.capture.synthesise.synthesise import synthesise

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
        bar = Progress(*columns)
        task = bar.add_task("images", total=None)

        def show(done: int, total: int) -> None:
            bar.start()  # not before: what is wrong with OUT is said without a bar
            bar.update(task, completed=done, total=total)

        try:
            synthesise(self.out, settings, self.name, self.overwrite, show, self.light,
                       Look(self.motion, self.clothes, self.folds, self.surface))
        finally:
            bar.stop()
        print(f"{self.out}: {settings.pixels} pixels, {settings.cameras} cameras")
        return 0
