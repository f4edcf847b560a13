"""Plays any motion file on a body: BVH, AMASS-like ``.npz``, a capture's ``poses.npz``, JSON keyframes."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body import arrays
from ndf_mi.body.body import Body
from ndf_mi.body.motion import (
    Motion,
    Place,
    frame_times,
    load_clip,
    require_finite,
    retarget,
    shaped_joints,
    shipped_clips,
)
from ndf_mi.body.motion_amass import Up, play_amass
from ndf_mi.body.motion_json import play_json
from ndf_mi.body.motion_smpl import as_cmu_rig
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.errors import InputError

DEFAULT_FPS = 30.0


@dataclass(frozen=True, eq=False)
class Performance:
    """A motion played on a body.

    Attributes:
        body: the body that moves.
        motion: T poses.
        fps: frames a second.
        shape: (B,) shape coefficients, or None for the template.
        stored: (T, V, 3) float32 posed vertices, if the file has them for this body and shape; else None.
    """

    body: Body
    motion: Motion
    fps: float
    shape: np.ndarray | None = None
    stored: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.motion.pose)

    def vertices(self, frame: int) -> np.ndarray:
        """(V, 3) float32: the posed body in the world, metres."""
        if self.stored is not None:
            return self.stored[frame]
        motion = self.motion
        flat = skin(self.body, motion.pose[frame], motion.root_rotation[frame], motion.translation[frame],
                    self.shape)
        return flat.numpy().reshape(-1, 3)


def read_performance(source: str | os.PathLike[str], body: Body, poses: Poses, *,
                     shape: np.ndarray | None = None, fps: float | None = None, place: Place = "world",
                     up: Up | None = None) -> Performance:
    """Reads a motion file, or a clip of the package by its name, and plays it on a body.

    Args:
        source: a file or the name of a clip.
        body: the body of a run.
        poses: the run's poses, for the performer's shape and, if the body has no model, its numbers of
            vertices and joints.
        shape: (B,) coefficients instead of the performer's.
        fps: frames a second; by default those of a JSON file, or 30. Each row of a ``poses.npz`` is one
            frame.
        place: as in `ndf_mi.body.motion.retarget`, for the root joint: ``centre`` and ``treadmill`` move the
            body over the origin.
        up: the vertical of an AMASS-like file, by default z; other files have none to choose.

    Raises:
        InputError: the file is of an unknown kind or has an error (see the readers), or an option does not
            apply to it.
    """
    own = poses.shape if shape is None else shape
    rate = DEFAULT_FPS if fps is None else fps
    kind = _kind(source)
    if up is not None and kind != "amass":
        raise InputError("up", up, "an AMASS-like file; in all other motions y is up")
    stored = None
    if kind == "bvh":
        clip = load_clip(source)
        motion = retarget(*as_cmu_rig(body, clip), frame_times(clip.duration, rate), shape=own)
    elif kind == "amass":
        motion = play_amass(body, source, rate, shape=own, up=up or "z")
    elif kind == "json":
        motion, rate = play_json(body, source, fps, shape=own)
    else:
        motion, stored = _play_poses(Path(source), body, poses, own, keep=shape is None)
    return _placed(Performance(body, motion, rate, own, stored), place)


def _kind(source: str | os.PathLike[str]) -> str:
    suffix = Path(source).suffix.lower()
    if str(source) in shipped_clips() or suffix == ".bvh":
        return "bvh"
    if not Path(source).is_file():
        expected = f".bvh, .npz or .json, or one of the clips {', '.join(shipped_clips())}"
        raise InputError(source, "no such file", f"a motion: {expected}")
    if suffix == ".json":
        return "json"
    if suffix == ".npz":
        found = arrays.read_npz(source, (), ("poses", "pose"))
        if found:
            return "amass" if "poses" in found else "poses"
        raise InputError(source, "neither poses nor pose among its arrays",
                         "AMASS's poses and trans, or a capture's poses.npz")
    raise InputError(source, f"the ending {suffix!r}", "a motion: .bvh, .npz or .json")


def _play_poses(
    path: Path, body: Body, reference: Poses, shape: np.ndarray | None, keep: bool
) -> tuple[Motion, np.ndarray | None]:
    """The rows of a capture's ``poses.npz`` and, if they belong to this very body, its vertices."""
    keys = ("frames", "pose", "root_rotation", "translation")
    found = arrays.read_npz(path, (*keys, "vertices"), ("shape",))
    theirs = Body.read(path.with_name("body.npz")) if path.with_name("body.npz").is_file() else None
    _check_joints(path, found["pose"], body, reference, theirs)
    names = body.joint_names or [str(j) for j in range(reference.pose.shape[1])]
    if found["frames"].ndim == 1 and len(found["frames"]) == len(found["pose"]):
        require_finite(f"{path}: pose", found["pose"], names, found["frames"])
    with arrays.located("poses", path):
        poses = Poses(**found)
    motion = Motion(poses.pose, poses.root_rotation, poses.translation)
    if keep and _same_body(poses, reference, body, theirs):
        return motion, poses.vertices
    if not body.skinned:
        found_count, count = poses.vertices.shape[1], reference.vertices.shape[1]
        raise InputError(f"{path}: vertices", f"{found_count} of another body",
                         f"{count} of the run's body, which has no model to pose it")
    return motion, None


def _check_joints(path: Path, pose: np.ndarray, body: Body, reference: Poses, theirs: Body | None) -> None:
    count = reference.pose.shape[1]
    own, other = body.joint_names, theirs.joint_names if theirs is not None else None
    if own and other and own != other:
        missing = [name for name in own if name not in other]
        spare = [name for name in other if name not in own]
        wrong = f"no {', '.join(missing)}" if missing else "joints in another order"
        wrong += f" (but {', '.join(spare)})" if spare else ""
        raise InputError(f"{path}: pose", f"{wrong}, according to body.npz", "the joints of the run's body")
    if pose.ndim != 3 or pose.shape[1:] != (count, 3) or pose.dtype.kind != "f":
        names = f": {', '.join(body.joint_names)}" if body.joint_names else ""
        raise InputError(f"{path}: pose", f"type {pose.dtype}, shape {pose.shape}",
                         f"(T, {count}, 3), the run's joints{names}")


def _same_body(poses: Poses, reference: Poses, body: Body, theirs: Body | None) -> bool:
    """Whether ``poses`` have the vertices of the run's body: number, shape and, if known, template."""
    if poses.vertices.shape[1] != reference.vertices.shape[1] or not _equal(poses.shape, reference.shape):
        return False
    return theirs is None or (
        _equal(theirs.template, body.template) and np.array_equal(theirs.faces, body.faces))


def _equal(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    return a is b if a is None or b is None else np.array_equal(a, b)


def _placed(performance: Performance, place: Place) -> Performance:
    """The performance moved over the origin, according to ``place``."""
    if place == "world":
        return performance
    motion = performance.motion
    if performance.body.skinned:
        joint = shaped_joints(performance.body, performance.shape)[0]
        at = Rotation.from_rotvec(motion.root_rotation).apply(joint) + motion.translation
    else:
        assert performance.stored is not None  # a body without a model has no other motion
        at = performance.stored.mean(1)
    shift = at * [1.0, 0.0, 1.0] if place == "treadmill" else (at.min(0) + at.max(0)) / 2 * [1.0, 0.0, 1.0]
    shift = np.broadcast_to(shift, at.shape).astype(np.float32)
    stored = None if performance.stored is None else performance.stored - shift[:, None]
    return replace(performance, motion=replace(motion, translation=motion.translation - shift), stored=stored)
