"""``ndf-mi capture synthesise``: makes a capture of a synthetic performer."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass
class CaptureSynthesise:
    """Render a capture of a synthetic, dressed performer by path tracing. An interrupted command can be
    continued.
    """

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
    """Folder of the capture: new, empty, or one where this command was interrupted."""
    size: Literal["tiny", "plan", "lit", "quick", "studio"] = "quick"
    """tiny (48 pixels, for tests), plan (80 pixels, 12 frames, for studies of `ndf-mi plan`), lit (96
    pixels, 3 frames, for relighting), quick (128 pixels, about a minute on two cores) or studio (256
    pixels, 21 cameras)."""
    light: Literal["studio", "evening", "carried", "flat"] = "studio"
    """The light; captures with the same other options differ only in it. carried: the studio's light, turning
    with the performer; flat: no light, surfaces show their reflectance. The capture does not describe these
    two."""
    motion: Literal["clips", "turn", "still"] = "clips"
    """Training motion. clips: walking and climbing; turn: one pose that turns around once; still: one
    pose.
    """
    clothes: Literal["loose", "tight", "coat", "skirt"] = "loose"
    """loose: clothes are centimetres away from the body; tight: within 12 mm; coat: an open coat to the
    calves over loose trousers; skirt: a wide skirt to the calves. The hems of coat and skirt are 15 cm and
    more away from the standing body.
    """
    hair: Literal["bob", "big", "hat", "none"] | None = None
    """bob: to the chin; big: curls, 15 to 20 cm away from the head; hat: a wide brim over a bob; none. By
    default bob, and none with tight clothes.
    """
    bag: bool = False
    """A rucksack on the back, 20 cm deep."""
    folds: bool = True
    """Whether cloth folds with the pose."""
    surface: Literal["mixed", "matte", "glossy"] = "mixed"
    """mixed: diffuse cloth with glossy skin, hair and shoes; matte: everything is diffuse; glossy: everything
    is glossy.
    """
    seed: int = 0
    """Seed of camera placement and rendering; the same seed gives the same capture."""
    name: str = "performer"
    """Name of the capture."""
    pixels: int | None = None
    """Width and height of the images; by default given by the size."""
    spp: int | None = None
    """Samples per pixel; by default given by the size."""
    cameras: int | None = None
    """Number of cameras in the ring; by default given by the size."""
    frames: int | None = None
    """Number of training frames; by default given by the size."""
    pose_frames: int | None = None
    """Number of novel poses; by default given by the size."""
    overwrite: bool = False
    """Replace a capture in OUT."""

    def run(self) -> int:
        """Makes the capture, with a progress bar."""
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
        from ndf_mi.capture.synthesise.synthesise import synthesise
        from ndf_mi.commands.progress import image_bar

        look = plan.Look(self.motion, self.clothes, self.folds, self.surface, self.hair, self.bag)
        with image_bar() as show:
            synthesise(self.out, settings, self.name, self.overwrite, show, self.light, look)
        print(f"{self.out}: {settings.pixels} pixels, {settings.cameras} cameras")
        return 0
