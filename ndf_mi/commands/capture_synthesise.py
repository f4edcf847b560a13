"""``ndf-mi capture synthesise``: makes a capture of a synthetic performer."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from ndf_mi.capture.synthesise.plan import Settings


@dataclass
class CaptureSynthesise:
    """Render a capture by path tracing: of a synthetic, dressed performer, or of a rigged and animated glTF
    character. An interrupted command can be continued.
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
    character: Path | None = None
    """A glTF file (.glb or .gltf) with a skinned, animated human to show in place of the performer. The
    capture's body is fitted to it.
    """
    animation: str | None = None
    """Name of the character's animation for training; by default the one with most movement."""
    novel_animation: str | None = None
    """Name of the character's animation for novel poses; by default another one with much movement. If it is
    the same, or there is only one, its last 30 % are for novel poses.
    """
    joints: Path | None = None
    """A JSON file that names the character's nodes, for rigs with unknown names: {"LeftUpLeg": "NAME", …}."""
    seed: int = 0
    """Seed of camera placement and rendering; the same seed gives the same capture."""
    name: str | None = None
    """Name of the capture; by default performer, or the character's file."""
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
        self._check_options()
        variants.use()
        if self.character is not None:
            return self._show_character(settings)
        from ndf_mi.capture.synthesise.synthesise import synthesise
        from ndf_mi.commands.progress import image_bar

        look = plan.Look(self.motion, self.clothes, self.folds, self.surface, self.hair, self.bag)
        with image_bar() as show:
            synthesise(self.out, settings, self.name or "performer", self.overwrite, show, self.light, look)
        print(f"{self.out}: {settings.pixels} pixels, {settings.cameras} cameras")
        return 0

    def _check_options(self) -> None:
        """Raises InputError at an option of the performer next to a character, or the other way round."""
        from ndf_mi.errors import InputError

        shared = {"out", "size", "light", "seed", "name", "pixels", "spp", "cameras", "frames", "pose_frames",
                  "overwrite", "character"}
        own = {"animation", "novel_animation", "joints"}
        for field in fields(self):
            applies = field.name in shared or (field.name in own) == (self.character is not None)
            if not applies and getattr(self, field.name) != field.default:
                option = f"--{field.name.replace('_', '-')}"
                raise InputError(option, "an option of " + ("characters" if field.name in own
                                                            else "the performer"),
                                 "no such option " + ("without" if field.name in own else "with")
                                 + " --character")

    def _show_character(self, settings: Settings) -> int:
        from ndf_mi.capture.synthesise.character.make import Source, synthesise_character
        from ndf_mi.commands.progress import image_bar

        assert self.character is not None
        source = Source(self.character, self.animation, self.novel_animation, self.joints)
        with image_bar("fit") as fitted, image_bar() as show:
            fit = synthesise_character(self.out, source, settings, self.name or self.character.stem,
                                       self.overwrite, show, self.light, fitted)
        for note in fit["notes"]:
            print(note)
        joints = fit["joints_mm"]
        worst = max(joints, key=joints.get)
        print(f"{self.out}: {settings.pixels} pixels, {settings.cameras} cameras; training frames of "
              f"{fit['training']}, novel poses of {fit['novel']}\n"
              f"fitted body: joints {fit['joints_mean_mm']:g} mm from the character's on average, at most "
              f"{joints[worst]:g} mm ({worst}); silhouettes overlap by {fit['iou']:.3f}; "
              f"{100 * fit['outside']:.1f} % of the body is more than 10 mm outside")
        return 0
