"""A character from a glTF file: surfaces, rig and animations, upright and in metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ndf_mi.capture.synthesise.character.animation import Animation, Nodes, read_animations
from ndf_mi.capture.synthesise.character.buffers import Buffers
from ndf_mi.capture.synthesise.character.document import read_document
from ndf_mi.capture.synthesise.character.geometry import Part, read_parts
from ndf_mi.capture.synthesise.character.joints import match_joints, order_by_depth
from ndf_mi.errors import InputError

#: The largest extent of what counts as in metres.
_LEAST, _MOST = 1.0, 2.5
#: Metres along the legs from the ankles to the hips, and on to the head's joint, in an average adult.
_AVERAGE = 1.42
_UNITS = {0.01: "centimetres", 0.001: "millimetres", 0.0254: "inches", 0.3048: "feet"}
#: Frames a second at which animations are compared.
_RATE = 10.0


class Character:
    """Reads a file; see `read_document` and `read_parts` for what is refused.

    Attributes:
        parts: its visible surfaces.
        nodes: its hierarchy.
        joints: the node of each of Anny's joints.
        bind: (N, 4, 4) nodes at rest, as they were when the surface was attached to them.
        animations: those that move joints, of more than one moment.
        notes: sentences about what was left out or changed.
    """

    def __init__(self, path: Path, mapping: Path | None = None) -> None:
        document = read_document(path)
        buffers = Buffers(document)
        self.path = Path(path)
        self.notes: list[str] = []
        self.nodes = Nodes(document)
        self.parts: list[Part] = read_parts(buffers, self.nodes, self.notes)
        skinned = sorted({int(node) for part in self.parts for node in part.nodes})
        self.joints = match_joints(self.nodes.names, order_by_depth(skinned, self.nodes.parents), str(path),
                                   mapping)
        self.bind = _bind(self.parts, self.nodes, set(self.joints.values()))
        self.animations: list[Animation] = [a for a in read_animations(buffers) if a.duration > 0]
        if not self.animations:
            raise document.error("animations", "no animation that moves the character", "an animation")
        self._upright = _upright(self.nodes, self.joints, self.parts, self.notes)
        if not all(np.isfinite(part.rest).all() for part in self.parts):
            raise document.error("meshes", "vertices that are not finite", "finite numbers")

    def world(self, animation: Animation, times: np.ndarray) -> np.ndarray:
        """(T, N, 4, 4) nodes to world space, upright and in metres, at (T,) seconds of an animation."""
        return self._upright @ self.nodes.world(self.nodes.local(animation, times))

    def vertices(self, world: np.ndarray) -> list[np.ndarray]:
        """(T, N, 3) vertices of each part, metres."""
        return [part.pose(world) for part in self.parts]

    def movement(self, animation: Animation) -> float:
        """Metres that joints move from the middle of the hips in an animation, on average over joints."""
        count = int(np.clip(animation.duration * _RATE, 2, 600))
        world = self.world(animation, np.linspace(animation.start, animation.end, count))
        at = world[..., :3, 3][:, list(self.joints.values())]
        hips = world[..., :3, 3][:, [self.joints["LeftUpLeg"], self.joints["RightUpLeg"]]].mean(axis=1)
        return float(np.linalg.norm(np.diff(at - hips[:, None], axis=0), axis=2).mean(axis=1).sum())


def _bind(parts: list[Part], nodes: Nodes, needed: set[int]) -> np.ndarray:
    """(N, 4, 4): the inverse of the inverse bind matrices of the skin that knows most joints; the nodes that
    it lacks keep their place relative to a parent or child, as at rest."""
    best = max(parts, key=lambda part: len(needed.intersection(part.nodes.tolist())))
    out = np.tile(np.eye(4), (len(nodes), 1, 1))
    known = np.zeros(len(nodes), dtype=bool)
    out[best.nodes] = np.linalg.inv(best.inverse)
    known[best.nodes] = True
    local = nodes.local()[0]
    for i in reversed(nodes.order):
        parent = nodes.parents[i]
        if parent >= 0 and known[i] and not known[parent]:
            out[parent] = out[i] @ np.linalg.pinv(local[i])
            known[parent] = True
    for i in nodes.order:
        parent = nodes.parents[i]
        if parent >= 0 and known[parent] and not known[i]:
            out[i] = out[parent] @ local[i]
            known[i] = True
    return out


def _upright(nodes: Nodes, joints: dict[str, int], parts: list[Part], notes: list[str]) -> np.ndarray:
    """(4, 4) from the file's world to one with y up, in metres."""
    world = nodes.world(nodes.local())[0]
    feet, hips = ([joints[f"{side}{name}"] for side in ("Left", "Right")] for name in ("Foot", "UpLeg"))
    knees = [joints[f"{side}Leg"] for side in ("Left", "Right")]
    head = world[joints["Head"], :3, 3]
    middle = world[hips, :3, 3].mean(axis=0)
    legs = (np.linalg.norm(world[hips, :3, 3] - world[knees, :3, 3], axis=1)
            + np.linalg.norm(world[knees, :3, 3] - world[feet, :3, 3], axis=1)).mean()
    length = float(legs + np.linalg.norm(head - middle))
    if not np.isfinite(length) or length < 1e-6:
        raise InputError("character", f"a rig of {length:g} from ankles to head", "joints that are apart")
    out = np.eye(4)
    axis = (head - middle) / np.linalg.norm(head - middle)
    if abs(axis[2]) > 0.8:
        up = np.sign(axis[2])
        out[:3, :3] = [[1, 0, 0], [0, 0, up], [0, -up, 0]]
        notes.append("The character lay along z at rest; z became the vertical.")
    vertices = np.concatenate([part.pose(world[None])[0] for part in parts])
    size = float(np.ptp(vertices, axis=0).max())
    if not _LEAST <= size <= _MOST:
        factor = next((f for f in _UNITS if _LEAST <= f * size <= _MOST), _AVERAGE / length)
        unit = f", as in {_UNITS[factor]}" if factor in _UNITS else ""
        notes.append(f"Lengths were multiplied by {factor:.4g}: the character is {size:.4g} high or "
                     f"wide{unit}.")
        out[:3] *= factor
    return out
