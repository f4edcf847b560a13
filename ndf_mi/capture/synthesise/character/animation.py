"""The nodes of a glTF file and its animations: transforms to world space over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ndf_mi.capture.synthesise.character.buffers import Buffers
from ndf_mi.capture.synthesise.character.document import Clip, Document

_WIDTHS = {"translation": 3, "rotation": 4, "scale": 3}


@dataclass(frozen=True)
class Track:
    """One property of a node over time.

    Attributes:
        node: index.
        path: ``translation``, ``rotation`` (quaternions, x y z w) or ``scale``.
        times: (K,) seconds, ascending.
        values: (K, n), or (K, 3, n) for CUBICSPLINE: incoming tangent, value, outgoing tangent.
        interpolation: ``STEP``, ``LINEAR`` or ``CUBICSPLINE``.
    """

    node: int
    path: str
    times: np.ndarray
    values: np.ndarray
    interpolation: str

    def at(self, times: np.ndarray) -> np.ndarray:
        """(T, n) values at (T,) seconds; the first or last key beyond the keys."""
        keys = self.times
        t = np.clip(times, keys[0], keys[-1])
        if len(keys) == 1 or self.interpolation == "STEP":
            values = self.values if self.values.ndim == 2 else self.values[:, 1]
            return values[np.searchsorted(keys, t, side="right") - 1]
        if self.interpolation == "LINEAR" and self.path == "rotation":
            return Slerp(keys, Rotation.from_quat(self.values))(t).as_quat()
        before = np.clip(np.searchsorted(keys, t, side="right") - 1, 0, len(keys) - 2)
        step = (keys[before + 1] - keys[before])[:, None]
        u = (t - keys[before])[:, None] / step
        if self.interpolation == "LINEAR":
            return (1 - u) * self.values[before] + u * self.values[before + 1]
        # Hermite's cubic, as in the glTF 2.0 specification, appendix C.
        start, end = self.values[before, 1], self.values[before + 1, 1]
        leave, arrive = self.values[before, 2] * step, self.values[before + 1, 0] * step
        return ((2 * u**3 - 3 * u**2 + 1) * start + (u**3 - 2 * u**2 + u) * leave
                + (-2 * u**3 + 3 * u**2) * end + (u**3 - u**2) * arrive)


@dataclass(frozen=True)
class Animation:
    """A named animation from ``start`` to ``end``, seconds."""

    name: str
    start: float
    end: float
    tracks: tuple[Track, ...]

    @property
    def duration(self) -> float:
        return self.end - self.start


class Nodes:
    """The hierarchy of N nodes.

    Attributes:
        names: N names, which may repeat or be empty.
        parents: (N,) -1 for roots.
        order: node indices, parents first.
    """

    def __init__(self, document: Document) -> None:
        nodes = document.gltf.nodes
        self.names = [node.name for node in nodes]
        self.parents = np.full(len(nodes), -1)
        for i, node in enumerate(nodes):
            for child in node.children:
                document.item(nodes, child, "nodes", f"nodes[{i}].children")
                if self.parents[child] >= 0:
                    raise document.error(f"nodes[{i}].children", f"nodes[{child}] as the child of two nodes",
                                         "a tree")
                self.parents[child] = i
        self.order = [i for i in range(len(nodes)) if self.parents[i] < 0]
        for i in self.order:
            self.order.extend(nodes[i].children)
        if len(self.order) < len(nodes):
            raise document.error("nodes", "a node that is its own ancestor", "a tree")
        self._translation = np.array([node.translation for node in nodes], dtype=float).reshape(-1, 3)
        self._rotation = np.array([node.rotation for node in nodes], dtype=float).reshape(-1, 4)
        self._scale = np.array([node.scale for node in nodes], dtype=float).reshape(-1, 3)
        bad = np.flatnonzero(np.abs(self._rotation).max(axis=1, initial=0) < 1e-6)
        if len(bad):
            raise document.error(f"nodes[{bad[0]}].rotation", "a quaternion of zeros", "a rotation")
        self._matrices = {i: np.array(node.matrix).reshape(4, 4).T
                          for i, node in enumerate(nodes) if node.matrix is not None}

    def __len__(self) -> int:
        return len(self.parents)

    def local(self, animation: Animation | None = None, times: np.ndarray | None = None) -> np.ndarray:
        """(T, N, 4, 4) transforms to the parent at (T,) seconds; without an animation, (1, N, 4, 4) at
        rest."""
        moments = np.zeros(1) if times is None else np.asarray(times, dtype=float)
        count = len(moments)
        values = {"translation": np.tile(self._translation, (count, 1, 1)),
                  "rotation": np.tile(self._rotation, (count, 1, 1)),
                  "scale": np.tile(self._scale, (count, 1, 1))}
        moved = set()
        for track in animation.tracks if animation is not None else ():
            values[track.path][:, track.node] = track.at(moments)
            moved.add(track.node)
        turns = Rotation.from_quat(values["rotation"].reshape(-1, 4)).as_matrix().reshape(count, -1, 3, 3)
        out = np.tile(np.eye(4), (count, len(self), 1, 1))
        out[..., :3, :3] = turns * values["scale"][:, :, None, :]
        out[..., :3, 3] = values["translation"]
        for i, matrix in self._matrices.items():
            if i not in moved:
                out[:, i] = matrix
        return out

    def world(self, local: np.ndarray) -> np.ndarray:
        """(T, N, 4, 4) transforms to world space of transforms to the parents."""
        out = local.copy()
        for i in self.order:
            if self.parents[i] >= 0:
                out[:, i] = out[:, self.parents[i]] @ local[:, i]
        return out


def read_animations(buffers: Buffers) -> list[Animation]:
    """All animations of a file that move nodes; those without a name are called ``animation0`` and so on.
    Raises InputError where the file is wrong."""
    clips = buffers.document.gltf.animations
    found = []
    for i, clip in enumerate(clips):
        tracks = _tracks(buffers, clip, f"animations[{i}]")
        if tracks:
            name = clip.name or f"animation{i}"
            found.append(Animation(name, float(min(t.times[0] for t in tracks)),
                                   float(max(t.times[-1] for t in tracks)), tuple(tracks)))
    return found


def _tracks(buffers: Buffers, clip: Clip, where: str) -> list[Track]:
    document = buffers.document
    tracks = []
    for k, channel in enumerate(clip.channels):
        target, place = channel.target, f"{where}.channels[{k}]"
        if target.node is None or target.path not in _WIDTHS:
            continue
        document.item(document.gltf.nodes, target.node, "nodes", place)
        sampler = document.item(clip.samplers, channel.sampler, "samplers", place)
        times = buffers.numbers(sampler.input, ("SCALAR",), f"{place}, times")[:, 0]
        kind = "VEC4" if target.path == "rotation" else "VEC3"
        values = buffers.numbers(sampler.output, (kind,), f"{place}, values")
        if sampler.interpolation not in ("STEP", "LINEAR", "CUBICSPLINE"):
            raise document.error(place, sampler.interpolation, "STEP, LINEAR or CUBICSPLINE")
        cubic = sampler.interpolation == "CUBICSPLINE"
        if len(values) != len(times) * (3 if cubic else 1):
            raise document.error(place, f"{len(times)} times and {len(values)} values",
                                 "three values for each time" if cubic else "as many values as times")
        if (np.diff(times) <= 0).any() or times[0] < 0:
            raise document.error(place, "times that do not ascend", "ascending times from 0 on")
        values = values.reshape(len(times), 3, -1) if cubic else values
        keys = values[:, 1] if cubic else values
        if target.path == "rotation" and np.abs(keys).max(axis=1).min() < 1e-6:
            raise document.error(place, "a quaternion of zeros", "rotations")
        tracks.append(Track(target.node, target.path, times, values, sampler.interpolation))
    return tracks
