"""Converts what a reader found into a capture: rectifies images, rotates the world, writes it."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.body.smpl import load_smpl
from ndf_mi.body.uv_file import read_uv
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.check import ON_MASK, fraction_on_mask
from ndf_mi.capture.document import Document, Imported
from ndf_mi.capture.readers.fits import JOINTS, Fits, read_fits, read_vertices
from ndf_mi.capture.readers.rectify import Rectifier, read_labels, read_rgb, shrunk, size_of
from ndf_mi.capture.readers.source import Source
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.errors import InputError

BACKGROUND = (0.0, 0.0, 0.0)

#: Largest mean distance in metres between a fit's vertices and the model's in the same pose.
_SAME_BODY = 0.02


def import_capture(
    source: Source,
    out: Path,
    smpl: Path | None = None,
    uv: Path | None = None,
    scale: float = 0.5,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[str]:
    """Writes ``source`` as a capture into the folder ``out``, completely or not at all.

    The world is rotated by quarter turns so that y is up. Without a model the body is only a mesh, which can
    take neither another motion nor another shape.

    Args:
        out: a new or empty folder.
        smpl: SMPL's model file; by default the body is the mesh of ``uv``.
        uv: texture coordinates (`ndf_mi.body.uv_file.read_uv`); by default the model gets a one-piece atlas.
        scale: size of the images relative to the original, in (0, 1].
        progress: called with the numbers of finished and of all images.

    Returns:
        Lines that describe the result.

    Raises:
        InputError: ``out`` is not empty; a file is missing or damaged; or model, fits, vertices and masks do
            not belong together.
    """
    if not 0 < scale <= 1:
        raise InputError("--scale", f"{scale:g}", "a number above 0 and at most 1")
    out = Path(out)
    if out.is_file() or (out.is_dir() and any(out.iterdir())):
        raise InputError(out, "something that exists already", "a new or empty folder")
    source.check_files()
    frames = sorted(source.fits)
    fits = read_fits([source.fits[frame] for frame in frames])
    body = _body(source, smpl, uv, len(fits.shape))
    vertices, lines = _vertices(source, body, fits, smpl, frames)
    turn = fits.upright()
    fits = fits.turned(turn)
    poses = Poses(frames=np.array(frames, dtype=np.int32), vertices=(vertices @ turn.T).astype(np.float32),
                  pose=fits.pose, root_rotation=fits.root_rotation, translation=fits.translation,
                  shape=_shape(fits, body))
    poses.check(body)
    images = {name: image for (name, _), (image, _) in reversed(source.images.items())}  # the first of each
    cameras = {}
    for name, image in images.items():
        calibration = source.calibrations[name]
        cameras[name] = calibration.camera(calibration.size or size_of(image), turn)
    imported = Imported(source.layout, source.subject, tuple(source.calibrations), source.selection.frames,
                        source.selection.test_frames, scale)
    ideal = {name: shrunk(cameras[name], scale) for name in source.calibrations if name in cameras}
    document = Document(source.name, BACKGROUND, ideal, source.splits, imported=imported)
    with _staged(out) as stage:
        _write(source, CaptureWriter(stage, document), body, poses, cameras, scale, progress)
    return lines


def _body(source: Source, smpl: Path | None, uv: Path | None, shape_count: int) -> Body:
    if smpl is not None:
        body = load_smpl(smpl, uv, shape_count, pose_blend_shapes=source.pose_blend_shapes)
        if body.joint_count != JOINTS:
            raise InputError(smpl, f"a model of {body.joint_count} joints",
                             f"SMPL's {JOINTS}, as in the fits")
        return body
    if uv is None:
        repair = ("The folder's vertices have no triangles: give --smpl MODEL, or --uv with an OBJ over "
                  "SMPL's vertices.")
        raise InputError("--smpl", "neither a model nor texture coordinates",
                         "SMPL's model file, .pkl or .npz", repair)
    found = read_uv(uv)
    if found.faces is None:
        raise InputError(uv, "texture coordinates without the vertices of their triangles",
                         "`faces` in the same file, or --smpl MODEL")
    return Body(faces=found.faces, uv=found.uv, uv_faces=found.uv_faces)


def _vertices(
    source: Source, body: Body, fits: Fits, smpl: Path | None, frames: list[int]
) -> tuple[np.ndarray, list[str]]:
    """(T, V, 3) vertices of the fits, from files if there are any, and lines that describe them."""

    def skinned(row: int) -> np.ndarray:
        flat = skin(body, fits.pose[row], fits.root_rotation[row], fits.translation[row], _shape(fits, body))
        return np.array(flat, dtype=np.float32).reshape(-1, 3)

    if not source.vertices:
        if not body.skinned:
            place = source.fits[frames[0]].parent
            raise InputError(place, "no posed vertices", "SMPL's model file to make them",
                             "Give --smpl MODEL.")
        return np.stack([skinned(row) for row in range(len(frames))]), ["vertices: skinned by the model"]
    files = [source.vertices[frame] for frame in frames]
    vertices = read_vertices(files)
    if body.template is None:
        return vertices, ["body: a mesh without a model, which cannot take another motion or shape"]
    if vertices.shape[1] != len(body.template):
        raise InputError(str(smpl), f"a model of {len(body.template)} vertices",
                         f"{vertices.shape[1]}, as {files[0]} has")
    distance = float(np.linalg.norm(skinned(0) - vertices[0], axis=1).mean())
    if distance > _SAME_BODY:
        repair = "Check the model's gender (ZJU-MoCap's fits need the neutral one), the fits, and --fits."
        found = f"vertices {1000 * distance:.0f} mm on average from {smpl} at {source.fits[frames[0]]}"
        raise InputError(files[0], found, f"at most {1000 * _SAME_BODY:.0f} mm", repair)
    return vertices, [f"vertices: from files, {1000 * distance:.1f} mm on average from the model's"]


def _shape(fits: Fits, body: Body) -> np.ndarray:
    """The shape coefficients, at most as many as the model has."""
    return fits.shape[: body.shape_count] if body.skinned else fits.shape


def _write(source: Source, writer: CaptureWriter, body: Body, poses: Poses, raw: dict[str, Camera],
           scale: float, progress: Callable[[int, int], None]) -> None:
    done = 0
    for name in writer.document.cameras:
        rectifier = Rectifier(raw[name], scale)
        size = (raw[name].w, raw[name].h)
        for frame in sorted(frame for camera, frame in source.images if camera == name):
            image_file, mask_file = source.images[name, frame]
            image = rectifier.image(read_rgb(image_file, size))
            mask = rectifier.mask(read_labels(mask_file, size, source.mask_above))
            _check_mask(mask_file, mask, rectifier.camera, poses, frame)
            writer.write(name, frame, np.where(mask[..., None], image, np.uint8(0)), mask)
            done += 1
            progress(done, len(source.images))
    writer.finish(body, poses)


def _check_mask(file: Path, mask: np.ndarray, camera: Camera, poses: Poses, frame: int) -> None:
    if not mask.any():
        raise InputError(file, "an empty mask", "some pixels of the performer")
    share = fraction_on_mask(camera, poses.vertices[poses.index(frame)], mask)
    if share < ON_MASK:
        found = f"only {share:.0%} of the fitted body's vertices on the mask, frame {frame}"
        repair = "Check frame numbers, and the units of calibrations (T in millimetres) and fits (metres)."
        raise InputError(file, found, f"{ON_MASK:.0%} or more", repair)


@contextmanager
def _staged(out: Path) -> Iterator[Path]:
    """A hidden folder that replaces ``out`` if the block succeeds, and otherwise is removed."""
    out = out.resolve()
    made = [parent for parent in out.parents if not parent.exists()]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        _remove_empty(made)
        raise InputError(out, f"a place that cannot be written ({error})", "a new folder's name") from None
    try:
        inner = stage / "capture"  # with the user's default permissions, unlike a temporary folder
        inner.mkdir()
        yield inner
        if out.is_dir():
            out.rmdir()
        os.replace(inner, out)
    finally:
        shutil.rmtree(stage, ignore_errors=True)
        if not out.exists():
            _remove_empty(made)


def _remove_empty(folders: Sequence[Path]) -> None:
    """Removes the empty ones of some folders, the innermost first."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
