"""SMPL's joints: names, tree, a skeleton at rest, and their counterparts in the ``cmu_mb`` rig.

Only SMPL's 24 joints have a counterpart of FingerBase. LHipJoint, RHipJoint, Neck1, LThumb, RThumb and
HandFinger1 have none, and follow their parents.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.bvh import Clip

BODY = ("pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle",
        "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head",
        "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist")
"""The 22 joints that SMPL, SMPL-H and SMPL-X share, in their order."""

_BODY_PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)
_HANDS = tuple(f"{side}_{finger}{i}" for side in ("left", "right")
               for finger in ("index", "middle", "pinky", "ring", "thumb") for i in (1, 2, 3))
_FACE = ("jaw", "left_eye_smplhf", "right_eye_smplhf")
LAYOUTS = {22: BODY, 24: (*BODY, "left_hand", "right_hand"), 52: BODY + _HANDS, 55: BODY + _FACE + _HANDS}
"""Joint names by their number: the body alone, SMPL, SMPL-H, SMPL-X."""

#: Rest positions in metres of the left side and the middle, rounded to centimetres: a T-pose, feet flat on
#: the ground. Retargeting uses only the directions of the limbs and the lengths of the legs.
_REST = {
    "pelvis": (0.00, -0.22, 0.03), "left_hip": (0.07, -0.31, 0.02), "left_knee": (0.10, -0.69, 0.02),
    "left_ankle": (0.09, -1.09, -0.03), "left_foot": (0.12, -1.15, 0.09), "spine1": (0.00, -0.11, 0.00),
    "spine2": (0.00, 0.02, 0.00), "spine3": (0.00, 0.07, 0.03), "neck": (0.00, 0.29, -0.01),
    "head": (0.00, 0.35, 0.04), "left_collar": (0.08, 0.19, -0.01), "left_shoulder": (0.17, 0.22, -0.02),
    "left_elbow": (0.43, 0.21, -0.04), "left_wrist": (0.68, 0.22, -0.04), "left_hand": (0.76, 0.21, -0.06),
}  # fmt: skip

_LEG = {"UpLeg": "hip", "Leg": "knee", "Foot": "ankle", "ToeBase": "foot"}
_ARM = {"Shoulder": "collar", "Arm": "shoulder", "ForeArm": "elbow", "Hand": "wrist", "FingerBase": "hand"}
_SIDES = (("Left", "left"), ("Right", "right"))
COUNTERPARTS = {"Hips": "pelvis", "LowerBack": "spine1", "Spine": "spine2", "Spine1": "spine3",
                "Neck": "neck", "Head": "head"} | {
    f"{cmu}{bone}": f"{smpl}_{joint}" for cmu, smpl in _SIDES for bone, joint in (_LEG | _ARM).items()
}
"""SMPL's joint for each joint of the ``cmu_mb`` rig that has a counterpart."""

#: The rig as chains of joints from the hips outwards.
_CHAINS: tuple[tuple[str, ...], ...] = (
    ("Hips", "LowerBack", "Spine", "Spine1", "Neck", "Neck1", "Head"),
    *(chain for side in ("Left", "Right") for chain in (
        ("Hips", f"{side[0]}HipJoint", f"{side}UpLeg", f"{side}Leg", f"{side}Foot", f"{side}ToeBase"),
        ("Spine1", f"{side}Shoulder", f"{side}Arm", f"{side}ForeArm", f"{side}Hand", f"{side}FingerBase",
         f"{side}HandFinger1"),
        (f"{side}Hand", f"{side[0]}Thumb"),
    )),
)  # fmt: skip


def parents(names: tuple[str, ...]) -> np.ndarray:
    """(J,) int32 parents of the joints of one of the `LAYOUTS`."""
    out = list(_BODY_PARENTS)
    for name in names[len(BODY) :]:
        if name in _FACE:
            out.append(BODY.index("head"))
        elif name in _HANDS and not name.endswith("1"):
            out.append(names.index(name) - 1)
        else:
            out.append(BODY.index("left_wrist" if name.startswith("left") else "right_wrist"))
    return np.array(out, dtype=np.int32)


def smpl_names(body: Body) -> tuple[str, ...] | None:
    """SMPL's names for the joints of a body: its own names if all are SMPL's, or else by their number if the
    tree is SMPL's; None for another rig."""
    own = body.joint_names
    known = {name for layout in LAYOUTS.values() for name in layout}
    if own is not None and own[0] == "pelvis" and set(own) <= known:
        return own
    names = LAYOUTS.get(body.joint_count)
    if names is not None and body.parents is not None and np.array_equal(body.parents, parents(names)):
        return names
    return None


def as_cmu_rig(body: Body, clip: Clip) -> tuple[Body, Clip]:
    """An SMPL body and its clip with the joint names of the ``cmu_mb`` rig; others unchanged.

    If the clip has all of the body's joints under the body's own names, they are renamed too; otherwise the
    clip has the rig's names already.
    """
    names = smpl_names(body)
    if names is None:
        return body, clip
    called = {smpl: cmu for cmu, smpl in COUNTERPARTS.items()}
    renamed = tuple(called.get(name, name) for name in names)
    own = dict(zip(body.joint_names or (), renamed, strict=False))
    if own and set(own) <= set(clip.joint_names):
        clip = dataclasses.replace(clip, joint_names=tuple(own.get(name, name) for name in clip.joint_names))
    return dataclasses.replace(body, joint_names=renamed), clip


def cmu_clip(clip: Clip) -> Clip:
    """A clip of SMPL's joints as one of the 31 joints of the ``cmu_mb`` rig, with a T-pose at rest. Joints
    without a counterpart keep still relative to their parents. The path of the root is unchanged."""
    above = {lower: upper for chain in _CHAINS for upper, lower in zip(chain, chain[1:], strict=False)}
    names = ["Hips", *above]
    rest = _rest_positions(names, above)
    offsets = np.array([rest[name] - rest[above[name]] if name in above else rest[name] for name in names])
    count = len(clip)
    rotations = np.tile(np.eye(3), (count, len(names), 1, 1))
    for j, name in enumerate(names):
        if COUNTERPARTS.get(name) in clip.joint_names:
            rotations[:, j] = clip.rotations[:, clip.joint_names.index(COUNTERPARTS[name])]
    positions = np.tile(offsets, (count, 1, 1))
    positions[:, 0] = clip.positions[:, 0]
    indices = np.array([names.index(above[name]) if name in above else -1 for name in names], dtype=np.int32)
    return Clip(clip.name, tuple(names), indices, offsets, clip.frame_time, positions, rotations)


def _rest_positions(names: list[str], above: dict[str, str]) -> dict[str, np.ndarray]:
    """Rest positions of the rig; joints without a counterpart are at their parent's, fingers beyond."""
    rest: dict[str, np.ndarray] = {}
    for name in names:
        joint = COUNTERPARTS.get(name)
        if joint is None:
            rest[name] = rest[above[name]].copy()
            if name.endswith("HandFinger1"):
                rest[name] += 0.5 * (rest[name] - rest[above[above[name]]])
        else:
            x, y, z = _REST[joint.replace("right_", "left_")]
            rest[name] = np.array([-x if joint.startswith("right_") else x, y, z])
    return rest
