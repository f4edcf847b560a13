"""A body: triangles, texture coordinates and, if known, the skinned model that poses it (``body.npz``)."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from ndf_mi import files
from ndf_mi.body import arrays
from ndf_mi.errors import InputError

MODEL = ("template", "joints", "joint_names", "parents", "weights")
"""The fields that skinning needs. Without them a body is a mesh with vertices in ``poses.npz``."""


@dataclass(frozen=True, eq=False)
class Body:
    """A triangle mesh with texture coordinates and an optional linear blend skinning model. Metres, y up.

    F triangles, V vertices, U texture coordinates, J joints, B shape coefficients. Every field is checked and
    converted to its type on construction. Two bodies are equal only if they are the same object.

    Attributes:
        faces: (F, 3) int32, the vertices of each triangle, counter-clockwise seen from outside.
        uv: (U, 2) float32 in [0, 1], v up.
        uv_faces: (F, 3) int32 into ``uv``, corner by corner with ``faces``.
        template: (V, 3) float32, the rest vertices at shape 0.
        joints: (J, 3) float32, the rest joints at shape 0.
        joint_names: J names, all different.
        parents: (J,) int32, the parent of each joint; -1 for the root, which comes first; parents precede
            children.
        weights: (V, J) float32, not negative; each row sums to 1 within 1e-3.
        shape_dirs: (V, 3, B) float32, added to the rest vertices by a shape coefficient of 1.
        pose_dirs: (V, 3, 9·(J-1)) float32, multiplied by R - I of all joints but the root, row by row.
        joint_dirs: (J, 3, B) float32, added to the rest joints by a shape coefficient of 1.
        shape_names: B names.

    Raises:
        InputError: a field is wrong; the message names it.
    """

    faces: np.ndarray
    uv: np.ndarray
    uv_faces: np.ndarray
    template: np.ndarray | None = None
    joints: np.ndarray | None = None
    joint_names: tuple[str, ...] | None = None
    parents: np.ndarray | None = None
    weights: np.ndarray | None = None
    shape_dirs: np.ndarray | None = None
    pose_dirs: np.ndarray | None = None
    joint_dirs: np.ndarray | None = None
    shape_names: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        for name, value in _checked(self).items():
            object.__setattr__(self, name, value)

    @property
    def skinned(self) -> bool:
        """Whether the body has all that linear blend skinning needs."""
        return all(getattr(self, name) is not None for name in MODEL)

    @property
    def joint_count(self) -> int:
        """J, or 0 if the joints are not known."""
        return 0 if self.joints is None else len(self.joints)

    @property
    def shape_count(self) -> int:
        """B, or 0 without shape blend shapes."""
        return 0 if self.shape_dirs is None else self.shape_dirs.shape[2]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Writes ``body.npz`` atomically, without the fields that are None."""
        fields = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        files.write_npz(path,
                        **{name: np.asarray(value) for name, value in fields.items() if value is not None})

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Body:
        """Reads and checks ``body.npz``.

        Raises:
            InputError: the file or a field is wrong; the message names the key.
        """
        names = [f.name for f in dataclasses.fields(cls)]
        found = arrays.read_npz(path, names[:3], names[3:])
        for name in ("joint_names", "shape_names"):
            if name in found and (found[name].dtype.kind != "U" or found[name].ndim != 1):
                kind = f"type {found[name].dtype}, shape {found[name].shape}"
                raise InputError(f"{path}: {name}", kind, "a list of strings")
        fields: dict[str, Any] = {k: tuple(v.tolist()) if k.endswith("_names") else v
                                  for k, v in found.items()}
        with arrays.located("body", path):
            return cls(**fields)


_SHAPES: dict[str, tuple[str | int, ...]] = {
    "template": ("V", 3), "joints": ("J", 3), "weights": ("V", "J"), "shape_dirs": ("V", 3, "B"),
    "pose_dirs": ("V", 3, "P"), "joint_dirs": ("J", 3, "B")}  # fmt: skip
"""The shapes of the optional arrays; P is 9·(J-1)."""


def _checked(body: Body) -> dict[str, np.ndarray | tuple[str, ...]]:
    """The fields that are given, in their types; raises InputError at the first that is wrong."""
    out: dict[str, np.ndarray | tuple[str, ...]] = {}
    uv = out["uv"] = arrays.floats("body: uv", body.uv, (None, 2))
    if len(uv) == 0:
        raise InputError("body: uv", "no texture coordinates", "a mesh with UVs")
    if uv.min() < 0 or uv.max() > 1:
        raise InputError("body: uv", f"values from {uv.min()} to {uv.max()}", "values from 0 to 1")
    sizes: dict[str | int, int | None] = {3: 3}
    for size, array in (("V", body.template), ("J", body.joints)):
        sizes[size] = None if array is None else len(array)
    joints = sizes["J"]
    sizes["P"] = None if joints is None else 9 * (joints - 1)
    limit = np.iinfo(np.int32).max if sizes["V"] is None else sizes["V"]
    faces = out["faces"] = arrays.indices("body: faces", body.faces, (None, 3), 0, limit)
    if len(faces) == 0:
        raise InputError("body: faces", "no triangle", "at least one")
    out["uv_faces"] = arrays.indices("body: uv_faces", body.uv_faces, (len(faces), 3), 0, len(uv))
    for name, shape in _SHAPES.items():
        if (array := getattr(body, name)) is not None:
            found = out[name] = arrays.floats(f"body: {name}", array, [sizes.get(size) for size in shape])
            if name == "shape_dirs":
                sizes["B"] = found.shape[2]
    if body.weights is not None:
        weights = np.asarray(out["weights"])
        off = np.abs(weights.sum(1, dtype=np.float64) - 1)
        if weights.min(initial=0) < 0 or off.max(initial=0) > 1e-3:
            worst = int(off.argmax())
            wrong = f"least weight {weights.min()}, and row {worst}, which sums to {weights[worst].sum()}"
            raise InputError("body: weights", wrong, "weights of 0 or more, in rows that sum to 1")
    if body.joint_names is not None:
        out["joint_names"] = _names("body: joint_names", body.joint_names, joints)
    if body.parents is not None:
        out["parents"] = _parents("body: parents", body.parents, joints)
    if body.shape_names is not None:
        out["shape_names"] = _names("body: shape_names", body.shape_names, sizes.get("B"))
    return out


def _names(where: str, names: tuple[str, ...], count: int | None) -> tuple[str, ...]:
    names = tuple(str(name) for name in names)
    if count is not None and len(names) != count:
        raise InputError(where, f"{len(names)} names", f"{count}")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(where, f"{', '.join(twice)} more than once", "each name once")
    return names


def _parents(where: str, parents: np.ndarray, count: int | None) -> np.ndarray:
    limit = len(np.atleast_1d(parents)) if count is None else count
    parents = arrays.indices(where, parents, (count,), -1, limit)
    wrong = [j for j, p in enumerate(parents) if (p != -1 if j == 0 else not 0 <= p < j)]
    if wrong:
        found = f"joint {wrong[0]} with the parent {parents[wrong[0]]}"
        raise InputError(where, found, "-1 for joint 0, and an earlier joint for every other")
    return parents
