"""Anny's first pose in each frame: the character's motion, played as a clip on Anny's joints."""

from __future__ import annotations

import itertools

import numpy as np

from ndf_mi.body.body import Body
from ndf_mi.body.bvh import Clip
from ndf_mi.body.motion import Motion, retarget

_UPRIGHT = ("Head", "LeftUpLeg", "RightUpLeg", "LeftLeg", "RightLeg", "LeftFoot", "RightFoot", "LeftArm",
            "RightArm")
#: An angle in radians up to which a rest pose counts as upright along an axis.
_SNAP = 0.35


def first_motion(body: Body, shape: np.ndarray, joints: dict[str, int], bind: np.ndarray,
                 world: np.ndarray) -> Motion:
    """Poses of ``body`` in T frames; positions are left to the fit.

    Args:
        joints: node of each of the body's joints that the character has.
        bind: (N, 4, 4) nodes to the space of the character at rest, where it stands like Anny, in any
            direction and unit.
        world: (T, N, 4, 4) nodes to world space.
    """
    assert body.joint_names is not None and body.parents is not None
    names, parents = body.joint_names, body.parents
    upright = _upright(body, joints, bind)
    turns = np.tile(np.eye(3), (len(world), len(names), 1, 1))
    places = np.zeros((len(world), len(names), 3))
    offsets = np.zeros((len(names), 3))
    at_rest = np.zeros((len(names), 3))
    hips = joints.get("Hips")
    for j, (name, parent) in enumerate(zip(names, parents, strict=True)):
        node = joints.get(name, hips if parent < 0 else None)
        middle = (joints["LeftUpLeg"], joints["RightUpLeg"])
        if parent >= 0:
            turns[:, j], places[:, j], at_rest[j] = turns[:, parent], places[:, parent], at_rest[parent]
        else:
            places[:, 0] = world[..., :3, 3][:, middle].mean(axis=1)
            at_rest[0] = upright @ bind[middle, :3, 3].mean(axis=0)
        if node is not None:
            # A turn from the upright rest pose, whatever the node's own axes are.
            rest = nearest_rotation(bind[node, :3, :3])
            turns[:, j] = nearest_rotation(world[:, node, :3, :3]) @ rest.T @ upright.T
            if parent >= 0:
                places[:, j], at_rest[j] = world[..., :3, 3][:, node], upright @ bind[node, :3, 3]
        elif name.endswith("HandFinger1"):
            # Straight on from the forearm.
            side = name[: -len("HandFinger1")]
            hand, elbow = (names.index(f"{side}{part}") for part in ("Hand", "ForeArm"))
            at_rest[j] = 2 * at_rest[hand] - at_rest[elbow]
        if parent >= 0:
            offsets[j] = at_rest[j] - at_rest[parent]
    local, positions = turns.copy(), places.copy()
    for j, parent in enumerate(parents):
        if parent >= 0:
            back = np.swapaxes(turns[:, parent], 1, 2)
            local[:, j] = back @ turns[:, j]
            positions[:, j] = np.einsum("tij,tj->ti", back, places[:, j] - places[:, parent])
    clip = Clip("character", names, parents, offsets, 1.0, positions, local)
    return retarget(body, clip, shape=shape)


def nearest_rotation(matrices: np.ndarray) -> np.ndarray:
    """(…, 3, 3) the rotations nearest to matrices that also scale."""
    u, _, v = np.linalg.svd(matrices)
    u[..., -1] *= np.sign(np.linalg.det(u @ v))[..., None]
    return u @ v


def _upright(body: Body, joints: dict[str, int], bind: np.ndarray) -> np.ndarray:
    """(3, 3) the rotation from the character's rest space to Anny's: along the axes, if that nearly fits."""
    assert body.joint_names is not None and body.joints is not None
    have = np.stack([bind[joints[name], :3, 3] for name in _UPRIGHT])
    want = np.stack([body.joints[body.joint_names.index(name)] for name in _UPRIGHT]).astype(float)
    have, want = have - have.mean(axis=0), want - want.mean(axis=0)
    turn = nearest_rotation(want.T @ have)
    for axes in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            along = np.eye(3)[list(axes)] * np.array(signs)
            if np.linalg.det(along) > 0 and np.trace(along.T @ turn) > 1 + 2 * np.cos(_SNAP):
                return along
    return turn
