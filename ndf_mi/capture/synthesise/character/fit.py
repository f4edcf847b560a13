"""Fits Anny to a moving character: by its joints, then by its outer surface, in all frames at once.

Unknown are the shape and one factor on all lengths; for each joint a turn that is the same in all frames,
since two rigs do not place joints and axes alike; and for each frame small turns and the translation. The
turns of all frames are close to the character's own motion, so the body moves as smoothly as it does.

The fit minimises squared distances by Gauss and Newton's method. What differs from frame to frame is
eliminated (Schur complement), so that the time grows linearly with the number of frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ndf_mi.body.body import Body
from ndf_mi.body.mesh import vertex_normals
from ndf_mi.body.poses import Poses
from ndf_mi.body.skinning import skin
from ndf_mi.capture.synthesise.character.retarget import first_motion
from ndf_mi.capture.synthesise.character.rig import Posed, Rig
from ndf_mi.capture.synthesise.character.skin import Skin

#: Standard deviations in metres of joints: how differently two rigs place them in the same body.
JOINT_SPREAD = {"UpLeg": 0.03, "Leg": 0.015, "Foot": 0.015, "ToeBase": 0.02, "Arm": 0.02, "ForeArm": 0.01,
                "Hand": 0.01, "HandFinger1": 0.015, "Neck": 0.05, "Head": 0.08}
_SHAPE, _SIZE = 1.0, 0.1
_TURN, _FRAME_TURN = np.radians(12.0), np.radians(2.0)
#: Metres: cloth further than this from the body says little about the body, in the first and the last step.
#: A narrow limit from the start would take a stout character's clothes for loose ones.
_LOOSE = 0.08, 0.012
_SURFACE, _REACH = 0.008, 0.12
_VERTICES = 1200
_JOINT_STEPS, _SURFACE_STEPS = 12, 14
#: Most radians that a joint turns in one step.
_MOST_TURN = 0.3


@dataclass(frozen=True)
class Target:
    """What the body is fitted to.

    Attributes:
        joints: the node of each of Anny's joints that the character has.
        bind: (N, 4, 4) nodes at rest.
        world: (T, N, 4, 4) nodes in each frame.
        skin: the outer surface.
    """

    joints: dict[str, int]
    bind: np.ndarray
    world: np.ndarray
    skin: Skin


@dataclass(frozen=True)
class _State:
    start: np.ndarray
    common: np.ndarray
    own: np.ndarray
    translation: np.ndarray
    shape: np.ndarray
    size: float

    def posed(self, rig: Rig, frame: int) -> Posed:
        return rig.pose(self.start[frame], self.common + self.own[frame], self.translation[frame], self.shape,
                        self.size)


def fit(body: Body, target: Target, progress: Callable[[int, int], None] = lambda done, total: None
        ) -> tuple[Body, Poses]:
    """Fits ``body`` to the character.

    Returns:
        The body, in the character's size, and its poses in the frames 0 to T - 1.
    """
    assert body.joint_names is not None and body.template is not None
    steps = _JOINT_STEPS + _SURFACE_STEPS
    names = [name for name in target.joints if limb(name) in JOINT_SPREAD]
    chosen = np.array([body.joint_names.index(name) for name in names])
    spread = np.array([JOINT_SPREAD[limb(name)] for name in names])
    wanted = target.world[..., :3, 3][:, [target.joints[name] for name in names]]

    state = _first(body, target, chosen, wanted)
    rig = Rig(body, np.array([], dtype=int))
    for step in range(_JOINT_STEPS):
        state = _step(rig, state, chosen, wanted, spread, None)
        progress(step + 1, steps)
    vertices = _spread_vertices(body)
    rig = Rig(body, vertices)
    for step in range(_SURFACE_STEPS):
        shaped = replace(body, template=_shaped(body, state))
        loose = max(_LOOSE[0] * 0.8**step, _LOOSE[1])
        state = _step(rig, state, chosen, wanted, spread, _Surface(shaped, vertices, target.skin, loose))
        progress(_JOINT_STEPS + step + 1, steps)
    return _result(body, state)


def limb(joint: str) -> str:
    """The name of a joint without its side."""
    return joint.removeprefix("Left").removeprefix("Right")


class _Surface:
    """Distances of the body's vertices from the outer surface, with weights."""

    def __init__(self, body: Body, vertices: np.ndarray, outer: Skin, loose: float) -> None:
        self._loose = loose
        assert body.template is not None and body.weights is not None
        self.count = len(vertices)
        self._normals = vertex_normals(body.template, body.faces)[vertices]
        self._weights = body.weights[vertices].astype(float)
        self._skin = outer

    def rows(self, frame: int, points: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, ...]:
        """(n,) vertices, (n, 3) directions, (n,) heights and (n,) weights; ``turns`` (J, 3, 3) to world."""
        normals = np.einsum("pj,jik,pk->pi", self._weights, turns, self._normals, optimize=True)
        height, facing, near = self._skin.heights(frame, points, normals, _REACH)
        # What stands out is pushed in; what is far inside is under loose clothes.
        weight = np.where(height > 0, 2.0, 1 / (1 + (height / self._loose) ** 2) ** 2) / _SURFACE**2
        rows = np.flatnonzero(near)
        return rows, facing[rows], height[rows], weight[rows]


def _first(body: Body, target: Target, chosen: np.ndarray, wanted: np.ndarray) -> _State:
    """The character's motion on Anny's joints, in the size of its legs and arms."""
    assert body.joints is not None and body.joint_names is not None
    shape = np.zeros(body.shape_count)
    motion = first_motion(body, shape.astype(np.float32), target.joints, target.bind, target.world)
    start = np.concatenate([motion.root_rotation[:, None], motion.pose[:, 1:]], axis=1).astype(float)
    rotations = Rotation.from_rotvec(start.reshape(-1, 3)).as_matrix().reshape(*start.shape, 3)
    none = np.zeros_like(body.joints, dtype=float)
    state = _State(rotations, none, np.zeros_like(start), np.zeros((len(start), 3)), shape, 0.0)
    rig = Rig(body, np.array([], dtype=int))
    at = np.stack([state.posed(rig, frame).points[chosen] for frame in range(len(start))])
    size = np.log(np.sqrt(wanted.var(axis=1).sum() / at.var(axis=1).sum()))
    shift = wanted.mean(axis=1) - np.exp(size) * at.mean(axis=1)
    return replace(state, size=float(size), translation=shift)


def _step(rig: Rig, state: _State, chosen: np.ndarray, wanted: np.ndarray, spread: np.ndarray,
          surface: _Surface | None) -> _State:
    """One step of Gauss and Newton."""
    joints, shapes = len(state.common), len(state.shape)
    turn, rest = 3 * joints, 3 * joints + 3
    shared = np.r_[0:turn, rest : rest + shapes + 1]
    own = np.r_[0:turn, turn:rest]
    first_joint = 0 if surface is None else surface.count
    prior = np.concatenate([np.full(turn, _TURN), np.full(shapes, _SHAPE), [_SIZE]]) ** -2.0
    total = np.diag(prior)
    pull = -prior * np.concatenate([state.common.ravel(), state.shape, [state.size]])
    solved = []
    for frame in range(len(state.start)):
        posed = state.posed(rig, frame)
        by_move = np.tile(np.eye(3), (len(posed.points), 1, 1))
        slopes = np.concatenate([posed.by_turn, by_move, posed.by_shape], axis=2)
        rows = slopes[first_joint + chosen] / spread[:, None, None]
        error = (wanted[frame] - posed.points[first_joint + chosen]) / spread[:, None]
        rows, error = rows.reshape(-1, rows.shape[2]), error.ravel()
        if surface is not None:
            turns = _world_turns(rig, state, frame)
            index, facing, height, weight = surface.rows(frame, posed.points[: surface.count], turns)
            # As many surface points count as much as one joint each square decimetre.
            root = np.sqrt(weight / len(height) * 40) if len(height) else weight
            flat = np.einsum("pi,pij->pj", facing, slopes[index]) * root[:, None]
            rows, error = np.concatenate([rows, flat]), np.concatenate([error, -height * root])
        square, slope = rows.T @ rows, rows.T @ error
        # The frame's own turns stay small; its translation is free.
        inner = square[np.ix_(own, own)].copy()
        inner[np.arange(turn), np.arange(turn)] += _FRAME_TURN**-2.0
        pulled = slope[own].copy()
        pulled[:turn] -= state.own[frame].ravel() / _FRAME_TURN**2
        across = square[np.ix_(own, shared)]
        both = np.linalg.solve(inner + 1e-9 * np.eye(rest), np.column_stack([across, pulled]))
        weighing = 1 / len(state.start)
        total += weighing * (square[np.ix_(shared, shared)] - across.T @ both[:, :-1])
        pull += weighing * (slope[shared] - across.T @ both[:, -1])
        solved.append(both)
    change = np.linalg.solve(total, pull)
    moves = np.stack([both[:, -1] - both[:, :-1] @ change for both in solved])
    common = change[:turn].reshape(-1, 3)
    turns = moves[:, :turn].reshape(-1, joints, 3)
    slow = min(1.0, _MOST_TURN / max(np.abs(common).max(), np.abs(turns).max(), 1e-9))
    return replace(state, common=state.common + slow * common, own=state.own + slow * turns,
                   translation=state.translation + slow * moves[:, turn:],
                   shape=state.shape + slow * change[turn:-1], size=float(state.size + slow * change[-1]))


def _world_turns(rig: Rig, state: _State, frame: int) -> np.ndarray:
    """(J, 3, 3) rotations of the joints to world space."""
    turns = state.start[frame] @ Rotation.from_rotvec(state.common + state.own[frame]).as_matrix()
    for j, p in enumerate(rig.parents):
        if p >= 0:
            turns[j] = turns[p] @ turns[j]
    return turns


def _spread_vertices(body: Body) -> np.ndarray:
    """Some vertices, so that each stands for about the same area at rest."""
    import trimesh

    assert body.template is not None
    mesh = trimesh.Trimesh(body.template, body.faces, process=False)
    _, index = trimesh.sample.sample_surface(mesh, _VERTICES, seed=0)
    return np.unique(body.faces[index, 0])


def _shaped(body: Body, state: _State) -> np.ndarray:
    assert body.template is not None and body.shape_dirs is not None
    return (np.exp(state.size) * (body.template + body.shape_dirs @ state.shape)).astype(np.float32)


def _result(body: Body, state: _State) -> tuple[Body, Poses]:
    assert body.template is not None and body.shape_dirs is not None
    assert body.joints is not None and body.joint_dirs is not None
    factor = np.float32(np.exp(state.size))
    sized = replace(body, template=factor * body.template, joints=factor * body.joints,
                    shape_dirs=factor * body.shape_dirs, joint_dirs=factor * body.joint_dirs)
    turns = state.start @ Rotation.from_rotvec((state.common + state.own).reshape(-1, 3)).as_matrix().reshape(
        *state.own.shape, 3)
    pose = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec().reshape(state.own.shape)
    root = pose[:, 0].astype(np.float32)
    pose = pose.astype(np.float32)
    pose[:, 0] = 0
    translation, shape = state.translation.astype(np.float32), state.shape.astype(np.float32)
    vertices = np.stack([np.asarray(skin(sized, *row, shape)).reshape(-1, 3)
                         for row in zip(pose, root, translation, strict=True)])
    return sized, Poses(np.arange(len(root)), vertices, pose, root, translation, shape)
