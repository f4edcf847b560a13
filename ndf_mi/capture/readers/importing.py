"""Makes a capture of what a reader found: rectifies images and masks, brings body and cameras into our world, writes the folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

from ndf_mi.body.body import Body
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.body.smpl import load_smpl
from ndf_mi.body.uv_file import read_uv
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.document import Document, Imported
from ndf_mi.capture.readers.fits import JOINTS, Fits, read_fits, read_vertices
from ndf_mi.capture.readers.rectify import Rectifier, read_labels, read_rgb, shrunk, size_of
from ndf_mi.capture.readers.source import Source
from ndf_mi.capture.writer import CaptureWriter
from ndf_mi.errors import InputError

BACKGROUND = (0.0, 0.0, 0.0)

#: Mean distance, in metres, of a fit's own vertices from those of the model at the fit's pose above which they don't belong together.
_SAME_BODY = 0.02

#: Least share of the body's vertices in the image that must fall on a mask, as `ndf-mi capture check` asks.
_ON_MASK = 0.5


def import_capture(
    source: Source,
    out: Path,
    smpl: Path | None = None,
    uv: Path | None = None,
    scale: float = 0.5,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[str]:
    """Writes ``source`` as a capture into the folder ``out``, all of it or nothing.

    The world is turned by quarters so that y is up. Without a model, the body is a mesh alone: its vertices move, but neither
    other motion nor another shape can be put on it.

    Args:
        source: what was found.
        out: a folder that is new or empty.
        smpl: SMPL's model file; None takes the triangles of ``uv``.
        uv: texel coordinates (`ndf_mi.body.uv_file.read_uv`); None cuts the model into one piece.
        scale: size of a pixel before to that after, in (0, 1].
        progress: called with the numbers of images done and to do.

    Returns:
        Lines that say what was made.

    Raises:
        InputError: ``out`` holds something; a file is missing or damaged; or model, fits, vertices and masks don't belong together.
    """
    if not 0 < scale <= 1:
        raise InputError("--scale", f"{scale:g}", "a number above 0, up to 1")
    out = Path(out)
    _check_free(out)
    source.check_files()
    frames = sorted(source.fits)
    fits = read_fits([source.fits[frame] for frame in frames])
    body = _body(source, smpl, uv, len(fits.shape))
    vertices, lines = _vertices(source, body, fits, smpl, frames)
    turn = fits.upright()
    fits = fits.turned(turn)
    poses = Poses(
        frames=np.array(frames, dtype=np.int32),
        vertices=(vertices @ turn.T).astype(np.float32),
        pose=fits.pose,
        root_rotation=fits.root_rotation,
        translation=fits.translation,
        shape=_shape(fits, body),
    )
    poses.check(body)
    cameras = {name: _raw_camera(source, name, turn) for name in {name for name, _ in source.images}}
    with _staged(out) as stage:
        _write(source, CaptureWriter(stage, _document(source, cameras, scale)), body, poses, cameras, scale, progress)
    return lines


def _body(source: Source, smpl: Path | None, uv: Path | None, shape_count: int) -> Body:
    if smpl is not None:
        body = load_smpl(smpl, uv, shape_count, pose_blend_shapes=source.pose_blend_shapes)
        if body.joint_count != JOINTS:
            raise InputError(smpl, f"a model of {body.joint_count} joints", f"SMPL's {JOINTS}, which the fits are of")
        return body
    if uv is None:
        repair = "The folder's vertices come without triangles: give --smpl MODEL, or --uv with an OBJ over SMPL's vertices."
        raise InputError("--smpl", "neither a model nor texel coordinates", "SMPL's model file, .pkl or .npz", repair)
    found = read_uv(uv)
    if found.faces is None:
        raise InputError(uv, "texel coordinates without the vertices of their triangles", "`faces` beside them, or --smpl MODEL")
    return Body(faces=found.faces, uv=found.uv, uv_faces=found.uv_faces)


def _vertices(source: Source, body: Body, fits: Fits, smpl: Path | None, frames: list[int]) -> tuple[np.ndarray, list[str]]:
    """(T, V, 3) vertices of the fits, those of the files where there are any, and what to say of them."""

    def skinned(row: int) -> np.ndarray:
        flat = skin(body, fits.pose[row], fits.root_rotation[row], fits.translation[row], _shape(fits, body))
        return np.array(flat, dtype=np.float32).reshape(-1, 3)

    if not source.vertices:
        if not body.skinned:
            place = source.fits[frames[0]].parent
            raise InputError(place, "no posed vertices beside it", "SMPL's model file, which gives them", "--smpl MODEL")
        return np.stack([skinned(row) for row in range(len(frames))]), ["vertices: the model's, at each fit"]
    files = [source.vertices[frame] for frame in frames]
    vertices = read_vertices(files)
    if body.template is None:
        return vertices, ["body: a mesh without a model, which no other motion or shape can be put on"]
    if vertices.shape[1] != len(body.template):
        raise InputError(str(smpl), f"a model of {len(body.template)} vertices", f"{vertices.shape[1]}, as {files[0]} has")
    distance = float(np.linalg.norm(skinned(0) - vertices[0], axis=1).mean())
    if distance > _SAME_BODY:
        repair = "look at the model's gender (ZJU-MoCap's fits are of the neutral one), at the fits, and at --fits"
        found = f"vertices {1000 * distance:.0f} mm on the mean from {smpl} at {source.fits[frames[0]]}"
        raise InputError(files[0], found, f"at most {1000 * _SAME_BODY:.0f} mm", repair)
    return vertices, [f"vertices: the files', {1000 * distance:.1f} mm on the mean from the model's"]


def _shape(fits: Fits, body: Body) -> np.ndarray:
    """The shape coefficients, no more than a model has."""
    return fits.shape[: body.shape_count] if body.skinned else fits.shape


def _raw_camera(source: Source, name: str, turn: np.ndarray) -> Camera:
    calibration = source.calibrations[name]
    size = calibration.size or size_of(next(image for (camera, _), (image, _) in source.images.items() if camera == name))
    return calibration.camera(size, turn)


def _document(source: Source, raw: dict[str, Camera], scale: float) -> Document:
    """What ``capture.json`` shall say: the ideal cameras, in the layout's order."""
    cameras = {name: shrunk(raw[name], scale) for name in source.calibrations if name in raw}
    chosen = source.selection
    imported = Imported(source.layout, source.subject, tuple(source.calibrations), chosen.frames, chosen.test_frames, scale)
    return Document(source.name, BACKGROUND, cameras, source.splits, imported=imported)


def _write(
    source: Source,
    writer: CaptureWriter,
    body: Body,
    poses: Poses,
    raw: dict[str, Camera],
    scale: float,
    progress: Callable[[int, int], None],
) -> None:
    done = 0
    for name in writer.document.cameras:
        rectifier = Rectifier(raw[name], scale)
        size = (raw[name].w, raw[name].h)
        for frame in sorted(frame for camera, frame in source.images if camera == name):
            image_file, mask_file = source.images[name, frame]
            image = rectifier.image(read_rgb(image_file, size))
            mask = rectifier.mask(read_labels(mask_file, size, source.mask_above))
            _check_mask(mask_file, mask, rectifier.camera, poses.vertices[poses.index(frame)], frame)
            writer.write(name, frame, np.where(mask[..., None], image, np.uint8(0)), mask)
            done += 1
            progress(done, len(source.images))
    writer.finish(body, poses)


def _check_mask(file: Path, mask: np.ndarray, camera: Camera, vertices: np.ndarray, frame: int) -> None:
    if not mask.any():
        raise InputError(file, "an empty mask", "some pixels of the performer")
    pixels = camera.project(vertices)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels < [camera.w, camera.h])).all(axis=1)
    columns, rows = np.floor(pixels[inside]).astype(int).T
    share = float(binary_dilation(mask)[rows, columns].mean()) if inside.any() else 0.0
    if share < _ON_MASK:
        found = f"only {share:.0%} of the fitted body's vertices seen on it, frame {frame}"
        repair = "look at the frames' numbers, the calibrations' units (T in millimetres) and the fits' (metres)"
        raise InputError(file, found, f"{_ON_MASK:.0%} or more", repair)


def _check_free(out: Path) -> None:
    if out.is_file() or (out.is_dir() and any(out.iterdir())):
        raise InputError(out, "something there already", "a new or empty folder")


@contextmanager
def _staged(out: Path) -> Iterator[Path]:
    """A hidden folder beside ``out`` that takes its place if the block succeeds, and else is removed, with the parents made for it."""
    out = out.resolve()
    made = [parent for parent in out.parents if not parent.exists()]
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    except OSError as error:
        _remove_empty(made)
        raise InputError(out, f"a place that cannot be written ({error})", "a new folder's name") from None
    try:
        inner = stage / "capture"  # made with the user's own permissions, which a temporary folder isn't
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
    """Removes those of the folders, the innermost first, that are there and hold nothing."""
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
