"""``ndf-mi animate``: renders a run in another motion, as a video."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from ndf_mi.commands.command_line import check_ranges
from ndf_mi.errors import InputError

if TYPE_CHECKING:
    from ndf_mi.animate.animation import Animation
    from ndf_mi.animate.frames import FrameFolder
    from ndf_mi.body.motion_file import Performance
    from ndf_mi.capture.camera import Camera
    from ndf_mi.run import Run


@dataclass
class Animate:
    """Render a trained field in any motion, as an MP4. Interrupt it at any time; the same command continues.

    Frames are kept next to the video, in OUT.frames. Frames that are still valid are not rendered again.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Folder of the run."""

    motion: str
    """A .bvh, an AMASS-like .npz, a poses.npz, JSON keyframes, or a built-in clip: climb, jump, walk."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The video: NAME.mp4."""

    camera: str = "orbit"
    """orbit: circle the performer. CAPTURE:NAME: a capture's camera. FILE: keyframed cameras in JSON."""

    shape: str | None = None
    """Shape coefficients to replace: by name, as in height=0.3,weight=-0.5, or the first ones as numbers."""

    fps: float | None = None
    """Frames a second. By default those of a JSON motion, else 30. A poses.npz has one row a frame."""

    frames: str | None = None
    """Part of the motion as FIRST:END:STEP, like a Python slice; a step lowers the video's frame rate."""

    size: tuple[int, int] | None = None
    """Width and height in pixels. By default the camera's own, or 512 × 512 for orbit."""

    spp: int = 1
    """Rays a pixel."""

    samples: int = 128
    """Candidate samples a ray."""

    background: tuple[float, float, float] | None = None
    """sRGB in [0, 1] behind the performer; by default the run's own."""

    place: Literal["world", "centre", "treadmill"] = "world"
    """world: the motion's own path. centre: the path centred at the origin. treadmill: above the origin."""

    up: Literal["z", "y"] | None = None
    """Vertical axis of an AMASS-like motion; z by default."""

    turns: float | None = None
    """orbit: full turns over the whole motion; 1 by default. 0 keeps the direction."""

    azimuth: float | None = None
    """orbit: degrees around the performer at the first frame; 0 by default."""

    elevation: float | None = None
    """orbit: degrees above the horizon; 5 by default."""

    def run(self) -> int:
        """Renders the missing frames, then writes the video."""
        from ndf_mi.animate.animation import Animation
        from ndf_mi.animate.frames import FrameFolder
        from ndf_mi.animate.shape import parse_shape
        from ndf_mi.animate.video import check_suffix
        from ndf_mi.body.motion_file import read_performance
        from ndf_mi.run import Run

        check_suffix(self.out)
        check_ranges(self)
        for name in ("turns", "azimuth", "elevation"):
            if getattr(self, name) is not None and self.camera != "orbit":
                raise InputError(f"--{name}", f"--camera {self.camera} as well", "--camera orbit")
        run = Run.load(self.run_folder)
        shape = None if self.shape is None else parse_shape(self.shape, run.body, run.poses.shape)
        performance = read_performance(
            self.motion, run.body, run.poses, shape=shape, fps=self.fps, place=self.place, up=self.up)
        frames = self._frames(len(performance))
        rate = performance.fps / frames.step
        if not 0.1 <= rate <= 240:
            where = "--frames" if self.frames else "--fps"
            raise InputError(where, f"{rate:g} frames a second", "a video of 0.1 to 240")
        cameras = self._cameras(performance)
        animation = Animation(
            run, performance, cameras, samples=self.samples, spp=self.spp, background=self.background)
        folder = FrameFolder(self.out.with_suffix(".frames"), self._request(run))
        self._render(animation, folder, frames, rate)
        print(f"{self.out}: {len(frames)} frames, {len(frames) / rate:.1f} s")
        return 0

    def _frames(self, count: int) -> range:
        """The requested frames of the motion, in order."""
        if self.frames is None:
            return range(count)
        try:
            parts = [int(part) if part.strip() else None for part in self.frames.split(":")]
        except ValueError:
            parts = []
        if not 2 <= len(parts) <= 3 or (len(parts) == 3 and parts[2] is not None and parts[2] < 1):
            expected = "FIRST:END or FIRST:END:STEP, whole numbers, a step above 0"
            raise InputError("--frames", repr(self.frames), expected)
        chosen = range(count)[slice(*parts)]
        if not chosen:
            found = f"no frame of the motion in {self.frames!r}"
            raise InputError("--frames", found, f"frames from 0 to {count - 1}")
        return chosen

    def _cameras(self, performance: Performance) -> list[Camera]:
        from ndf_mi.animate.animation import boxes
        from ndf_mi.animate.cameras import orbit, read_cameras

        if self.camera == "orbit":
            names = ("turns", "azimuth", "elevation")
            given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
            return orbit(boxes(performance), *(self.size or (512, 512)), performance.fps, **given)
        cameras = read_cameras(self.camera, len(performance), performance.fps)
        return cameras if self.size is None else [camera.scaled(*self.size) for camera in cameras]

    def _request(self, run: Run) -> dict[str, Any]:
        """The options, for people who find the frames."""
        names = (name for name in type(self).__dataclass_fields__ if name not in ("out", "run_folder"))
        values = {name: getattr(self, name) for name in names}
        return {"run": str(run.path)} | {name: value for name, value in values.items() if value is not None}

    def _render(self, animation: Animation, folder: FrameFolder, frames: range, rate: float) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

        from ndf_mi.animate.video import write_video

        missing = animation.missing(folder, frames)
        console, total = Console(file=sys.stderr), len(frames)
        columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        try:
            with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
                task = bar.add_task("rendering", total=total, completed=total - len(missing))
                animation.write(folder, missing, lambda: bar.advance(task))
                encoding = bar.add_task("encoding", total=total)
                write_video(self.out, [folder.frame(frame) for frame in frames], rate,
                            lambda: bar.advance(encoding))
        except KeyboardInterrupt:
            done = total - len(animation.missing(folder, frames))
            print(f"stopped with {done} of {total} frames in {folder.path}; the same command continues")
            raise
