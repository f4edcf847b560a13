"""``ndf-mi render``: renders a scene or a run to an image."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ndf_mi.commands.command_line import check_ranges
from ndf_mi.errors import InputError

if TYPE_CHECKING:
    from ndf_mi.capture.camera import Camera
    from ndf_mi.capture.capture import Capture
    from ndf_mi.render.image import Image
    from ndf_mi.run import Run

#: Options that apply only to runs.
RUN_ONLY = (
    "capture", "azimuth", "elevation", "budget", "error", "stratified", "samples", "cutoff", "networks")
#: Options that a run's `ndf_mi.render.settings.Setting` is made of.
SETTINGS = ("samples", "cutoff", "stratified", "networks", "spp")


@dataclass
class Render:
    """Render a Mitsuba scene, or a trained run by itself, to .png (sRGB) or .exr (linear, with depth,
    opacity, (u, v, l) and normals where a run or the scene's integrator provides them)."""

    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE_OR_RUN")]
    """A scene's XML file or a run's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The image to write: NAME.png or NAME.exr."""

    frame: int | None = None
    """The frame to render; by default the one in the scene, or the run's first."""

    size: tuple[int, int] | None = None
    """Width and height in pixels; by default those of the scene or camera, or 512 × 512 for a run if there
    is no --capture."""

    spp: int | None = None
    """Samples per pixel; by default those of the scene, or 1, through pixel centres, for a run."""

    samples: int | None = None
    """Run: candidate samples per ray (default: 128)."""

    cutoff: float | None = None
    """Run: early termination: follow each ray until its transmittance falls to this (default: 0.0001); 0
    follows it to its end."""

    stratified: bool = False
    """Run: shift each ray's samples at random, which gives noise instead of bands."""

    networks: Literal["auto", "batched", "fused", "half"] | None = None
    """Run: evaluate networks as matrix products over all samples (batched), as cooperative vectors (fused),
    or as cooperative vectors in half precision (half); by default whichever of batched and fused is
    faster."""

    budget: str | None = None
    """Run: choose --samples and --cutoff for the best image within a time such as 0.5s, 300ms or 2min, not
    counting the compiling of kernels. Uses a profile of this machine, which is measured on first use and
    stored."""

    error: str | None = None
    """Run: choose --samples and --cutoff for the fastest image that loses no more than this, such as 0.5dB,
    of the PSNR that the run reaches on its training images."""

    define: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-D"]), tyro.conf.UseAppendAction] = ()
    """Scene: set a parameter of the scene, as NAME=VALUE, e.g. run=runs/demo; can be repeated."""

    capture: Path | None = None
    """Run: the capture that --camera belongs to. Cameras that the run was trained on have the corrections
    that it learned (`ndf-mi optimise --refine cameras --camera-colours`)."""

    camera: str | None = None
    """Run: the name of a camera of --capture. Scene: the number of a sensor, counted from 0."""

    azimuth: float = 0.0
    """Run without --capture: the camera's angle around the performer, in degrees."""

    elevation: float = 5.0
    """Run without --capture: the camera's angle above the horizon, in degrees."""

    def run(self) -> int:
        """Renders and writes the image."""
        from ndf_mi.render.output import check_suffix

        check_suffix(self.out)
        check_ranges(self)
        if self.source.is_dir():
            self._render_run()
        elif self.source.is_file():
            self._render_scene()
        else:
            raise InputError(self.source, "no such file or folder", "a scene's XML file or a run's folder")
        print(self.out)
        return 0

    def _render_run(self) -> None:
        from ndf_mi.capture.capture import Capture
        from ndf_mi.learn.refined import refined_camera, seen_by
        from ndf_mi.render.output import write_field_image
        from ndf_mi.render.performers import misread
        from ndf_mi.run import Run

        if self.define:
            raise InputError("--define", "it together with a run", "it only with a scene")
        budget, error = self._limits()
        run = Run.load(self.source)
        if (text := misread(run, scattering=False)) is not None:
            _print_error(f"ndf-mi: warning: {run.path}: {text}.")
        frame = int(run.poses.frames[0]) if self.frame is None else self.frame
        capture = None if self.capture is None else Capture.read(self.capture)
        camera = self._camera(run, frame, capture)
        trained_on = capture is not None and capture.digest == (run.config.get("capture") or {}).get("digest")
        if trained_on:
            camera = refined_camera(run, camera)
        image = self._image(run, frame, camera, budget, error)
        if trained_on:
            image.linear = seen_by(run, camera, image.linear, image.opacity)
        write_field_image(self.out, image, run.background)

    def _limits(self) -> tuple[float | None, float | None]:
        """Seconds and dB of --budget and --error.

        Raises:
            InputError: they are invalid, or given together, or with an option that they choose or that
                profiles do not cover.
        """
        from ndf_mi.render.tuner import parse_decibel, parse_seconds

        if self.budget is not None and self.error is not None:
            raise InputError("--budget", "it together with --error", "one of them")
        given = [name for name in SETTINGS if getattr(self, name) not in (None, False)]
        limit = "budget" if self.budget is not None else "error"
        if getattr(self, limit) is not None and given:
            reason = "chooses it" if given[0] in ("samples", "cutoff") else "works only without it"
            expected = f"one of them: --{limit} {reason}"
            raise InputError(f"--{limit}", f"it together with --{given[0]}", expected)
        seconds = None if self.budget is None else parse_seconds(self.budget)
        return seconds, None if self.error is None else parse_decibel(self.error)

    def _camera(self, run: Run, frame: int, capture: Capture | None) -> Camera:
        from ndf_mi.capture.camera import framing

        if capture is not None:
            cameras = capture.cameras
            if self.camera not in cameras:
                raise InputError("--camera", str(self.camera), "one of " + ", ".join(cameras))
            camera = cameras[self.camera]
            return camera if self.size is None else camera.scaled(*self.size)
        if self.camera is not None:
            expected = "--capture as well, or --azimuth and --elevation instead"
            raise InputError("--camera", self.camera, expected)
        vertices = run.poses.vertices[run.poses.index(frame)]
        return framing(vertices, *(self.size or (512, 512)), self.azimuth, self.elevation)

    def _image(
        self, run: Run, frame: int, camera: Camera, budget: float | None, error: float | None
    ) -> Image:
        from ndf_mi.render.settings import Setting
        from ndf_mi.render.tuner import choose, render_choice

        geometry = self.out.suffix.lower() == ".exr"
        if budget is None and error is None:
            given = {name: getattr(self, name) for name in SETTINGS if getattr(self, name) is not None}
            return Setting(**given).image(run, frame, camera, geometry)
        choice = choose(run, frame, camera, geometry, _print_error, budget=budget, error=error)
        _print_error(choice.describe())
        return render_choice(choice, run, frame, camera, geometry, _print_error)

    def _render_scene(self) -> None:
        from ndf_mi.render.output import write_exr, write_png
        from ndf_mi.render.scene import load_scene, render_scene
        from ndf_mi.render.scene_issues import scene_issues

        for name in RUN_ONLY:
            # Defaults of a dataclass are attributes of its class.
            if getattr(self, name) != getattr(Render, name):
                raise InputError(f"--{name}", "it together with a scene", "it only with a run")
        sensor = 0
        if self.camera is not None:
            if not self.camera.isdecimal():
                expected = "the number of one of the scene's sensors, from 0"
                raise InputError("--camera", repr(self.camera), expected)
            sensor = int(self.camera)
        scene = load_scene(self.source, self._scene_parameters())
        # Only warnings: a performer may be left out of an image on purpose.
        for issue in dict.fromkeys(scene_issues(scene)):
            _print_error(f"ndf-mi: warning: {issue}")
        channels, srgb = render_scene(scene, sensor, self.spp or 0, self.size)
        if self.out.suffix.lower() == ".exr":
            write_exr(self.out, channels)
        else:
            write_png(self.out, srgb)

    def _scene_parameters(self) -> dict[str, str]:
        parameters = {}
        for text in self.define:
            name, equals, value = text.partition("=")
            if not equals or not name:
                raise InputError("--define", repr(text), "NAME=VALUE")
            parameters[name] = value
        if self.frame is not None:
            parameters["frame"] = str(self.frame)
        return parameters


def _print_error(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
