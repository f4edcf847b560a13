"""Makes a synthetic capture: poses the performer, renders all splits, and writes the folder."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from dataclasses import asdict
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull

from ndf_mi.body.anny import load_anny
from ndf_mi.body.poses import Poses
from ndf_mi.capture.document import FILE_NAME, Document
from ndf_mi.capture.synthesise import lighting, plan
from ndf_mi.capture.synthesise.performer import Performer
from ndf_mi.capture.synthesise.ring import camera_ring
from ndf_mi.capture.synthesise.studio import Studio
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.colour import linear_to_srgb, srgb_to_linear
from ndf_mi.errors import InputError
from ndf_mi.files import is_left_over, write_json
from ndf_mi.json_input import load_json

#: The settings of a folder, which show whether an interrupted run can continue there.
SETTINGS_FILE = "synthesis.json"
#: How well the body fits a character.
FIT_FILE = "fit.json"
#: sRGB of the background.
BACKGROUND = (0.5, 0.5, 0.5)
#: Increased whenever the same settings give different pictures.
RECIPE = 2

_OWN_FILES = (FILE_NAME, "body.npz", "poses.npz", lighting.SCENE, lighting.ENVIRONMENT, SETTINGS_FILE,
              FIT_FILE)
_OWN_FOLDERS = ("images", "masks")


def synthesise(
    out: Path,
    settings: plan.Settings,
    name: str = "performer",
    overwrite: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
    light: str = lighting.DEFAULT,
    look: plan.Look = plan.Look(),  # noqa: B008
) -> Path:
    """Makes a capture in the folder ``out``, or continues an interrupted call with the same settings.

    Args:
        out: a folder that is new, empty, or holds a capture with the same settings; a finished one stays
            unchanged.
        overwrite: replaces a capture in ``out``, but never anything else.
        progress: called with the numbers of finished and of all images, first with those that exist already.
        light: name of the light. With the same settings and name, performer, poses, cameras and masks do not
            depend on it.

    Returns:
        ``out``.

    Raises:
        InputError: ``out`` holds something else; no such light; or the body's data are missing.
    """
    out = Path(out)
    constant = lighting.light(light).constant
    # Default choices and lights are left out, so that captures made before there was a choice are recognised.
    made_with = {"name": name, "recipe": RECIPE, "mitsuba": metadata.version("mitsuba"), **asdict(settings),
                 **look.changes()}
    if light != lighting.DEFAULT:
        made_with["light"] = light
    claim(out, made_with, overwrite)
    body = load_anny()
    poses = plan.motion(body, settings, look.motion)
    performer = Performer(body, plan.shape_of(body), look) if look.wide else None
    worn = None if performer is None else _corners(performer, poses)
    cameras = camera_ring(settings.cameras, settings.pixels, poses.vertices, settings.seed, worn)
    scene = lighting.SCENE if constant else None
    document = Document(name, BACKGROUND, cameras, plan.splits(settings, list(cameras)), lighting=scene)
    if (out / FILE_NAME).is_file():
        progress(len(document.images()), len(document.images()))
        return out
    write_json(out / SETTINGS_FILE, made_with)

    def make_studio() -> tuple[Studio, Callable[[int], None]]:
        shown = performer or Performer(body, plan.shape_of(body), look)
        studio = Studio(shown.layers, settings.spp, light)

        def pose(frame: int) -> None:
            row = poses.index(frame)
            layers = _posed(shown, poses, row)
            studio.pose(layers, plan.heading(poses.root_rotation[row]))

        return studio, pose

    writer = CaptureWriter(out, document)
    render_missing(writer, make_studio, settings.seed, progress)
    if constant:
        lighting.write(out, light)
    writer.finish(body, poses)
    return out


def _posed(performer: Performer, poses: Poses, row: int) -> list[np.ndarray]:
    return performer.pose(poses.pose[row], poses.root_rotation[row], poses.translation[row],
                          poses.vertices[row])


def _corners(performer: Performer, poses: Poses) -> np.ndarray:
    """(N, 3) corners of the convex hulls of what is worn, in all poses."""
    posed = (np.concatenate(_posed(performer, poses, row)) for row in range(len(poses)))
    return np.concatenate([points[ConvexHull(points).vertices] for points in posed])


def render_missing(writer: CaptureWriter, make_studio: Callable[[], tuple[Studio, Callable[[int], None]]],
                   seed: int, progress: Callable[[int, int], None]) -> None:
    """Renders the images of the writer's document that do not exist yet.

    Args:
        make_studio: called if an image is missing; returns a studio and what poses it in a frame.
        progress: called with the numbers of finished and of all images.
    """
    pairs, cameras = writer.document.images(), writer.document.cameras
    missing = [pair for pair in pairs if not writer.has(*pair)]
    done = len(pairs) - len(missing)
    progress(done, len(pairs))
    if not missing:
        return
    studio, pose = make_studio()
    for frame in sorted({frame for _, frame in missing}):
        pose(frame)
        for camera in (camera for camera, of in missing if of == frame):
            number = (seed * 1009 + frame) * 101 + list(cameras).index(camera)
            radiance, coverage = studio.render(cameras[camera], number % 2**31)
            writer.write(camera, frame, composite(radiance, coverage), coverage > 0)
            done += 1
            progress(done, len(pairs))


def composite(radiance: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """(h, w, 3) sRGB: premultiplied linear radiance over the background, blended in linear light."""
    behind = (1 - coverage[..., None]) * np.asarray(srgb_to_linear(np.array(BACKGROUND)))
    return np.asarray(linear_to_srgb(np.clip(radiance + behind, 0, 1)))


def claim(out: Path, made_with: dict[str, Any], overwrite: bool) -> None:
    """Checks that ``out`` is new, empty or a capture with the settings ``made_with``; removes another one if
    ``overwrite``. Raises InputError if it is something else."""
    if out.is_file():
        raise InputError(out, "a file", "a folder")
    names = sorted(p.name for p in out.iterdir() if not is_left_over(p)) if out.is_dir() else []
    if not names:
        return
    foreign = [name for name in names if name not in _OWN_FILES + _OWN_FOLDERS]
    has_settings = (out / SETTINGS_FILE).is_file()
    if foreign or not (has_settings or (out / FILE_NAME).is_file()):
        raise InputError(out, f"a folder with other contents ({', '.join((foreign or names)[:4])})",
                         "a new or empty folder")
    if not overwrite:
        with contextlib.suppress(InputError):
            if load_json(out / SETTINGS_FILE, "settings") == made_with:
                return
        raise InputError(out, "a capture made with other settings",
                         f"a new or empty folder, or one with the same settings in {SETTINGS_FILE}",
                         "Choose another folder, or replace the capture with --overwrite.")
    for folder in _OWN_FOLDERS:
        shutil.rmtree(out / folder, ignore_errors=True)
    for file in _OWN_FILES:
        (out / file).unlink(missing_ok=True)
