"""``ndf-mi render``: a scene or a run to an image."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro

from ndf_mi.errors import InputError

if TYPE_CHECKING:
    from ndf_mi.capture.camera import Camera
    from ndf_mi.render.image import Image
    from ndf_mi.run import Run


@dataclass
class Render:
    """Render a Mitsuba scene, or a trained run by itself, to .png (sRGB) or .exr (linear, with depth, opacity, (u, v, l) and
    normals where a run or the scene's integrator gives them)."""

    source: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE_OR_RUN")]
    """A scene's XML, or a run's folder."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The image: NAME.png or NAME.exr."""

    frame: int | None = None
    """The frame; by default the scene's own, or the run's first."""

    size: tuple[int, int] | None = None
    """Width and height in pixels; by default the scene's or the camera's own, 512 × 512 for a run without --capture."""

    spp: int | None = None
    """Samples a pixel: by default the scene's own; for a run 1, through pixels' centres."""

    samples: int | None = None
    """Run: candidate samples a ray; 128 by default."""

    cutoff: float | None = None
    """Run: early termination, the transmittance up to which a ray is followed; 0.0001 by default, 0 follows every ray to its end."""

    stratified: bool = False
    """Run: shift each ray's samples by a random part of their distance: noise in place of bands."""

    networks: Literal["auto", "batched", "fused", "half"] | None = None
    """Run: networks as matrix products over all samples, as cooperative vectors, or as these in half precision; by default the quicker
    of the first two."""

    budget: str | None = None
    """Run: choose --samples and --cutoff for the best picture in a time such as 0.5s, 300ms or 2min, once kernels are compiled. From
    a profile of this machine, which is measured on first use and kept. Pictures are neither --stratified nor drawn by other --networks."""

    error: str | None = None
    """Run: choose the same for the quickest picture that gives up no more than so much, such as 0.5dB, of the PSNR that the run reaches on
    the images it was trained on."""

    define: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["-D"]), tyro.conf.UseAppendAction] = ()
    """Scene: a parameter of the scene as NAME=VALUE, e.g. run=runs/demo; may be given several times."""

    capture: Path | None = None
    """Run: take --camera from this capture."""

    camera: str | None = None
    """Run: a camera of --capture, by name. Scene: the number of the sensor, from 0."""

    azimuth: float = 0.0
    """Run without --capture: degrees around the performer."""

    elevation: float = 5.0
    """Run without --capture: degrees above the horizon."""

    def run(self) -> int:
        """Renders and writes the image."""
        from ndf_mi.render.output import check_suffix

        check_suffix(self.out)
        if self.size is not None and min(self.size) < 1:
            raise InputError("--size", f"{self.size[0]} {self.size[1]}", "two whole numbers above 0")
        if self.samples is not None and self.samples < 1:
            raise InputError("--samples", str(self.samples), "a whole number above 0")
        if self.cutoff is not None and not 0 <= self.cutoff < 1:
            raise InputError("--cutoff", f"{self.cutoff:g}", "a transmittance in [0, 1)")
        if self.spp is not None and self.spp < 1:
            raise InputError("--spp", str(self.spp), "a whole number above 0")
        if not -90 < self.elevation < 90:
            raise InputError("--elevation", str(self.elevation), "degrees between -90 and 90")
        if self.source.is_dir():
            self._run()
        elif self.source.is_file():
            self._scene()
        else:
            raise InputError(self.source, "no such file or folder", "a scene's XML or a run's folder")
        print(self.out)
        return 0

    def _run(self) -> None:
        from ndf_mi.capture.capture import Capture
        from ndf_mi.capture.viewpoint import framing
        from ndf_mi.render.colours import misread
        from ndf_mi.render.output import write_exr, write_png
        from ndf_mi.run import Run

        if self.define:
            raise InputError("--define", "it together with a run", "it only with a scene")
        budget, error = self._wish()
        run = Run.load(self.source)
        if (text := misread(run, scattering=False)) is not None:
            print(f"ndf-mi: warning: {run.path}: {text}.", file=sys.stderr, flush=True)
        frame = int(run.poses.frames[0]) if self.frame is None else self.frame
        row = run.poses.index(frame)
        if self.capture is not None:
            cameras = Capture.read(self.capture).cameras
            if self.camera not in cameras:
                raise InputError("--camera", str(self.camera), "one of " + ", ".join(cameras))
            camera = cameras[self.camera]
            if self.size is not None:
                camera = camera.scaled(*self.size)
        elif self.camera is not None:
            raise InputError("--camera", self.camera, "--capture beside it, or --azimuth and --elevation instead")
        else:
            if not abs(self.azimuth) < float("inf"):
                raise InputError("--azimuth", f"{self.azimuth:g}", "a finite number of degrees")
            if not -90 < self.elevation < 90:
                raise InputError("--elevation", f"{self.elevation:g}", "degrees between -90 and 90")
            camera = framing(run.poses.vertices[row], *(self.size or (512, 512)), self.azimuth, self.elevation)
        image = self._image(run, frame, camera, budget, error)
        if image.u is None or image.normal is None:
            write_png(self.out, image.over(run.background))
            return
        channels = dict(zip("RGB", np.moveaxis(image.linear, -1, 0), strict=True)) | {"A": image.opacity, "depth.T": image.depth}
        channels |= {f"uvl.{n}": image.u[..., i] for i, n in enumerate("UVL")}
        channels |= {f"normal.{n}": image.normal[..., i] for i, n in enumerate("XYZ")}
        write_exr(self.out, channels)

    def _wish(self) -> tuple[float | None, float | None]:
        """The seconds and the dB asked for. Raises InputError where they, or one of them and another way to draw, are given together."""
        from ndf_mi.render.tuner import parse_decibel, parse_seconds

        if self.budget is not None and self.error is not None:
            raise InputError("--budget", "it together with --error", "one of them")
        for wish in ("budget", "error"):
            chosen = [name for name in (*self._turned(), "spp") if getattr(self, name) not in (None, False)]
            if getattr(self, wish) is not None and chosen:
                why = f"chooses --{chosen[0]}" if chosen[0] in ("samples", "cutoff") else "knows pictures without it alone"
                raise InputError(f"--{wish}", f"it together with --{chosen[0]}", f"one of them: --{wish} {why}")
        return (None if self.budget is None else parse_seconds(self.budget), None if self.error is None else parse_decibel(self.error))

    def _turned(self) -> tuple[str, ...]:
        """The options that say how a run is drawn, at None or False where they are not given."""
        return ("samples", "cutoff", "stratified", "networks")

    def _image(self, run: Run, frame: int, camera: Camera, budget: float | None, error: float | None) -> Image:
        from ndf_mi.render.settings import Setting
        from ndf_mi.render.tuner import choose, drawn_in_time

        def tell(text: str) -> None:
            print(text, file=sys.stderr, flush=True)

        geometry = self.out.suffix.lower() == ".exr"
        if budget is None and error is None:
            given = {name: getattr(self, name) for name in (*self._turned(), "spp") if getattr(self, name) is not None}
            return Setting(**given).image(run, frame, camera, geometry)
        choice = choose(run, frame, camera, geometry, tell, budget=budget, error=error)
        tell(choice.told())
        return drawn_in_time(choice, run, frame, camera, geometry, tell)

    def _scene(self) -> None:
        from ndf_mi.render.output import write_exr, write_png
        from ndf_mi.render.scene import load_scene, render_scene
        from ndf_mi.render.scene_issues import scene_issues

        mine = {"capture": None, "azimuth": 0.0, "elevation": 5.0, "budget": None, "error": None, "stratified": False,
                "samples": None, "cutoff": None, "networks": None}
        for name, default in mine.items():
            if getattr(self, name) != default:
                raise InputError(f"--{name}", "it together with a scene", "it only with a run")
        parameters = {}
        for text in self.define:
            name, equals, value = text.partition("=")
            if not equals or not name:
                raise InputError("--define", repr(text), "NAME=VALUE")
            parameters[name] = value
        if self.frame is not None:
            parameters["frame"] = str(self.frame)
        sensor = 0
        if self.camera is not None:
            if not self.camera.isdecimal():
                raise InputError("--camera", repr(self.camera), "the number of one of the scene's sensors, from 0")
            sensor = int(self.camera)
        scene = load_scene(self.source, parameters)
        # Told, and rendered all the same: a performer may be left out of a picture on purpose.
        for issue in dict.fromkeys(scene_issues(scene)):
            print(f"ndf-mi: warning: {issue}", file=sys.stderr, flush=True)
        channels, srgb = render_scene(scene, sensor, self.spp or 0, self.size)
        if self.out.suffix.lower() == ".exr":
            write_exr(self.out, channels)
        else:
            write_png(self.out, srgb)
