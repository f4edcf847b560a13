"""Plays a motion clip on a body: retargets it from a CMU-like BVH skeleton to a rig with the same joints."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.bvh import Clip, read_bvh
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.errors import InputError

ALIASES = {"LFingers": "LeftHandFinger1", "RFingers": "RightHandFinger1"}
"""Joints whose names in the CMU clips differ from those in the ``cmu_mb`` rig."""

_LIMBS = (("UpLeg", "Leg"), ("Leg", "Foot"), ("Arm", "ForeArm"), ("ForeArm", "Hand"), ("Hand", "HandFinger1"))
AIMS = {f"{side}{bone}": f"{side}{tip}" for side in ("Left", "Right") for bone, tip in _LIMBS}
"""The bones whose rest directions are aligned, from their joint to the joint at their end: the limbs, where a
T-pose differs from an A-pose. Trunk, head and clavicles are not aligned, since two skeletons place their
joints differently inside bodies that stand in the same way. Feet and fingers follow the bone above them."""

LEGS = tuple(tuple(f"{side}{bone}" for bone in ("UpLeg", "Leg", "Foot")) for side in ("Left", "Right"))
"""The joints of each leg from the hip down. The path is scaled by the ratio of the legs' lengths."""

MOST_FRAMES = 200_000
"""Frames of the longest motion, nearly two hours at 30 frames a second. More means wrong times in a file."""

MOST_NAMES = 40
"""How many joints a message lists."""

Place = Literal["world", "centre", "treadmill"]

_DATA = Path(__file__).parent / "data"


@dataclass(frozen=True, eq=False)
class Motion:
    """T poses of a body's J joints; fields as in `Poses`: (T, J, 3), (T, 3) and (T, 3) float32."""

    pose: np.ndarray
    root_rotation: np.ndarray
    translation: np.ndarray


def shipped_clips() -> tuple[str, ...]:
    """The names of the clips that come with the package."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.bvh")))


def load_clip(name_or_path: str | os.PathLike[str]) -> Clip:
    """A clip of the package by its name, or any BVH file by its path; InputError if there is neither, or the
    file is not BVH."""
    names = shipped_clips()
    path = _DATA / f"{name_or_path}.bvh" if str(name_or_path) in names else Path(name_or_path)
    if not path.is_file():
        raise InputError("motion", str(name_or_path), f"a BVH file or one of the clips {', '.join(names)}")
    return read_bvh(path)


def retarget(body: Body, clip: Clip, times: np.ndarray | Sequence[float] | None = None, *,
             shape: np.ndarray | Sequence[float] | None = None, place: Place = "world",
             alike: Collection[str] = ()) -> Motion:
    """Plays ``clip`` on ``body``.

    World rotations are copied joint by joint, after the rest directions of the limbs are aligned (`AIMS`).
    The path of the hips is scaled by the ratio of the leg lengths, and shifted vertically so that the lowest
    point which the feet reach in the clip lies on y = 0.

    A rig whose legs are not named as in `LEGS` is not aligned: body and clip must have the same rest pose.
    Its path is that of the root joint, scaled by the ratio of the lengths of all bones. A rig without joints
    named Foot or ToeBase is put on the ground by its lowest vertex.

    Args:
        times: seconds after the clip's first frame; by default those of the clip's frames.
        shape: (B,) shape coefficients; the joints follow them.
        place: ``world`` keeps the clip's path, ``centre`` moves the middle of its horizontal extent to the
            origin, ``treadmill`` removes all horizontal movement of the hips, so that the body stays above
            the origin.
        alike: joints with the same orientation in both rest poses, such as feet flat on the ground.

    Raises:
        InputError: the clip lacks joints of the body, the body has no rig, or a time is outside the clip.
    """
    joints, columns = shaped_joints(body, shape), _match(body, clip)
    align = _alignment(body, clip, joints, columns, alike)
    own = np.arange(len(clip)) * clip.frame_time
    some = own[np.unique(np.linspace(0, len(clip) - 1, min(len(clip), 240)).round().astype(int))]
    whole = _play(body, clip.at(some), joints, columns, align)
    played = _play(body, clip.at(own if times is None else np.asarray(times)), joints, columns, align)
    path = played.translation.astype(np.float64)
    path[:, 1] -= _lowest(body, whole, joints, shape).min()
    hips, all_hips = (_hip_centre(body, m, joints)[:, [0, 2]] for m in (played, whole))
    if place == "centre":
        path[:, [0, 2]] -= (all_hips.min(0) + all_hips.max(0)) / 2
    elif place == "treadmill":
        path[:, [0, 2]] -= hips
    return Motion(played.pose, played.root_rotation, path.astype(np.float32))


def pose_sequence(body: Body, clip: Clip, frames: Sequence[int] | np.ndarray | None = None, *,
                  rate: float = 30.0, shape: np.ndarray | Sequence[float] | None = None,
                  place: Place = "world") -> Poses:
    """`Poses` of ``body`` playing ``clip``, skinned; frame f shows the clip at f/rate seconds.

    Args:
        frames: frame numbers, ascending; by default all of the clip.
        rate: frames a second.
        shape, place: as in `retarget`, also for errors.
    """
    if frames is None:
        frames = np.arange(int(np.floor(clip.duration * rate + 1e-3)) + 1)
    frames = np.asarray(frames, dtype=np.int32)
    motion = retarget(body, clip, frames / rate, shape=shape, place=place)
    coefficients = None if shape is None else np.asarray(shape, dtype=np.float32)
    rows = zip(motion.pose, motion.root_rotation, motion.translation, strict=True)
    vertices = np.stack([np.asarray(skin(body, *row, coefficients)).reshape(-1, 3) for row in rows])
    return Poses(frames, vertices, motion.pose, motion.root_rotation, motion.translation, coefficients)


def frame_times(duration: float, fps: float) -> np.ndarray:
    """(T,) the times of the frames in a motion of ``duration`` seconds, the first at 0; InputError if there
    would be more than `MOST_FRAMES`."""
    if not duration * fps < MOST_FRAMES:
        raise InputError("motion", f"{duration:g} s at {fps:g} frames a second",
                         f"at most {MOST_FRAMES:,} frames",
                         "Correct the times in the file, or use a smaller --fps.")
    return np.minimum(np.arange(int(np.floor(duration * fps + 1e-3)) + 1) / fps, duration)


def require_finite(where: str, values: np.ndarray, names: Sequence[str],
                   frames: Sequence[int] | np.ndarray | None = None) -> None:
    """Raises InputError, with frame and joint, unless ``values``, (T, J, 3) of ``names``, are finite."""
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        row, joint, axis = bad[0]
        frame = row if frames is None else frames[row]
        raise InputError(where, f"{values[row, joint, axis]} at frame {frame}, joint {names[joint]}",
                         "finite numbers")


def shaped_joints(body: Body, shape: np.ndarray | Sequence[float] | None = None) -> np.ndarray:
    """(J, 3) float64 rest joints at a shape; InputError if the body has no rig, or other coefficients."""
    if not body.skinned:
        raise InputError("body", "no skinning model", "a body with joints, parents and weights")
    joints = np.asarray(body.joints, dtype=np.float64)
    if shape is None:
        return joints
    if np.shape(shape) != (body.shape_count,):
        raise InputError("shape", f"shape {np.shape(shape)}", f"({body.shape_count},)")
    if body.joint_dirs is None:
        return joints
    return joints + body.joint_dirs.astype(np.float64) @ np.asarray(shape)


def _match(body: Body, clip: Clip) -> list[int]:
    """The clip's joint for each joint of the body."""
    named = {ALIASES.get(name, name): j for j, name in enumerate(clip.joint_names)}
    assert body.joint_names is not None
    missing = [name for name in body.joint_names if name not in named]
    if missing:
        spare = [name for name in clip.joint_names if ALIASES.get(name, name) not in body.joint_names]
        more = f" and {len(spare) - MOST_NAMES} more" if len(spare) > MOST_NAMES else ""
        others = f" (but {', '.join(spare[:MOST_NAMES])}{more})" if spare else ""
        found = f"no {', '.join(missing)}{others}"
        raise InputError(f"clip {clip.name}", found, "the joints of the body's rig")
    return [named[name] for name in body.joint_names]


def _alignment(
    body: Body, clip: Clip, joints: np.ndarray, columns: list[int], alike: Collection[str]
) -> np.ndarray:
    """(J, 3, 3) rotations from the body's rest pose to the clip's; each joint inherits its parent's."""
    rest = clip.offsets.copy()
    for j, p in enumerate(clip.parents):
        rest[j] += rest[p] if p >= 0 else 0
    names = body.joint_names or ()
    turns = np.tile(np.eye(3), (len(names), 1, 1))
    for j, (name, parent) in enumerate(zip(names, body.parents, strict=True)):  # type: ignore[arg-type]
        if parent >= 0 and name not in alike:
            turns[j] = turns[parent]
        if AIMS.get(name) in names:
            tip = names.index(AIMS[name])
            have, want = turns[j] @ (joints[tip] - joints[j]), rest[columns[tip]] - rest[columns[j]]
            turns[j] = _between(have, want) @ turns[j]
    return turns


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The smallest rotation from ``a`` to the direction of ``b``; the identity if one has no length."""
    lengths = np.linalg.norm(a) * np.linalg.norm(b)
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis)
    if lengths < 1e-12 or sine < 1e-9 * lengths:
        return np.eye(3)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, a @ b)).as_matrix()


def _play(body: Body, clip: Clip, joints: np.ndarray, columns: list[int], align: np.ndarray) -> Motion:
    """Rotations and the path of the hips, before the body is put on the ground."""
    rotations, positions = clip.forward()
    world = rotations[:, columns] @ align
    local = world.copy()
    for j, p in enumerate(body.parents):  # type: ignore[arg-type]
        if p >= 0:
            local[:, j] = np.swapaxes(world[:, p], 1, 2) @ world[:, j]
    pose = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec().reshape(len(clip), -1, 3)
    pose[:, 0] = 0
    have, want = (_length(_bones(body), at) for at in (joints, positions[0, columns]))
    if not want > 0:
        raise InputError(f"clip {clip.name}", "bones of no length", "offsets between the joints")
    centre = positions[:, [columns[j] for j in _hips(body)]].mean(1) * (have / want)
    still = Motion(pose, Rotation.from_matrix(world[:, 0]).as_rotvec(), np.zeros((len(clip), 3)))
    path = centre - _hip_centre(body, still, joints)
    return Motion(pose.astype(np.float32), still.root_rotation.astype(np.float32), path.astype(np.float32))


def _forward(body: Body, motion: Motion, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World rotations (T, J, 3, 3) and positions (T, J, 3) of the body's joints, float64."""
    assert body.parents is not None
    rotations = Rotation.from_rotvec(motion.pose.reshape(-1, 3)).as_matrix().reshape(*motion.pose.shape, 3)
    root = Rotation.from_rotvec(motion.root_rotation).as_matrix()
    rotations[:, 0] = root @ rotations[:, 0]
    offsets = joints - joints[body.parents]
    positions = np.tile(offsets, (len(root), 1, 1))
    positions[:, 0] = root @ joints[0] + motion.translation
    return Clip("", body.joint_names or (), body.parents, offsets, 1.0, positions, rotations).forward()


def _hip_centre(body: Body, motion: Motion, joints: np.ndarray) -> np.ndarray:
    """(T, 3): the middle between the hip joints, or the root joint (`_hips`)."""
    return _forward(body, motion, joints)[1][:, _hips(body)].mean(1)


def _legs(body: Body) -> list[list[int]]:
    """The joints of `LEGS`, leg by leg; none if the rig lacks one of them."""
    place = {name: j for j, name in enumerate(body.joint_names or ())}
    known = all(name in place for leg in LEGS for name in leg)
    return [[place[name] for name in leg] for leg in LEGS] if known else []


def _hips(body: Body) -> list[int]:
    """The joints whose middle is the body's position: the hip joints, or else the root."""
    return [leg[0] for leg in _legs(body)] or [0]


def _bones(body: Body) -> list[tuple[int, int]]:
    """The pairs of joints whose distances give the body's size: along the legs, or else all bones."""
    assert body.parents is not None
    along_legs = [pair for leg in _legs(body) for pair in zip(leg, leg[1:], strict=False)]
    return along_legs or [(p, j) for j, p in enumerate(body.parents.tolist()) if p >= 0]


def _length(bones: Sequence[tuple[int, int]], at: np.ndarray) -> float:
    """The sum of the lengths of bones, for joints at ``at``, (J, 3)."""
    return float(sum(np.linalg.norm(at[a] - at[b]) for a, b in bones))


def _lowest(
    body: Body, motion: Motion, joints: np.ndarray, shape: np.ndarray | Sequence[float] | None
) -> np.ndarray:
    """(T,) the height of the lowest point of the feet, or of the whole body if no joint has such a name. Each
    vertex moves with the joint of its largest weight."""
    assert body.template is not None and body.weights is not None
    rest = body.template.astype(np.float64)
    if shape is not None and body.shape_dirs is not None:
        rest = rest + body.shape_dirs @ np.asarray(shape)
    turns, at = _forward(body, motion, joints)
    owner = body.weights.argmax(1)
    low = np.full(len(at), np.inf)
    feet = [j for j, name in enumerate(body.joint_names or ())
            if name.endswith(("Foot", "ToeBase")) and (owner == j).any()]
    for j in feet or np.unique(owner).tolist():
        held = rest[owner == j] - joints[j]
        low = np.minimum(low, (turns[:, j, 1] @ held.T).min(1) + at[:, j, 1])
    return low
