"""SMPL's model files (Loper et al. 2015) as bodies. The files are licensed and not part of this.

What the file calls ``v_template``, ``shapedirs``, ``posedirs``, ``J_regressor``, ``weights`` and ``kintree_table`` are T̄, S, P, 𝒥,
𝒲 and the kinematic tree of the paper's equations 2 to 10. Rest joints are 𝒥(T̄ + S·β) and so linear in β, which is how the body
holds them: ``joints`` = 𝒥·T̄ and ``joint_dirs`` = 𝒥·S. The root turns about the world's origin (`ndf_mi.body.skinning`), where
SMPL's own first joint turns about itself: a pose's first three numbers must be zero.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from ndf_mi import unpickle
from ndf_mi.body import arrays
from ndf_mi.body.body import Body
from ndf_mi.body.uv_file import read_uv
from ndf_mi.errors import InputError

JOINT_NAMES = (
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle", "spine3",
    "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
)  # fmt: skip
"""SMPL's 24 joints; models of another number get numbered names."""

_KEYS = ("v_template", "f", "weights", "J_regressor", "kintree_table", "shapedirs", "posedirs")
_REQUIRED = _KEYS[:5]
_NO_PARENT = (-1, 2**32 - 1)


def load_smpl(
    path: str | os.PathLike[str],
    uv: str | os.PathLike[str] | None = None,
    shape_count: int = 10,
    pose_blend_shapes: bool = True,
) -> Body:
    """Reads an SMPL model file as a body; SMPL-like models of other sizes (SMPL+H, animals) are read as well.

    Args:
        path: ``.pkl``, of Python 2 or 3, with arrays of numpy, scipy.sparse or chumpy (none of which it can make run
            anything, see `ndf_mi.unpickle`); or ``.npz`` with the same keys.
        uv: a file of texel coordinates over the same vertices and triangles (`read_uv`); without it the body is cut open and
            flattened into one chart (`ndf_mi.body.atlas.one_piece`).
        shape_count: B, how many of the file's shape coefficients are kept, the first ones; all where it has fewer.
        pose_blend_shapes: False leaves out P, as fits made without it want.

    Raises:
        InputError: the file is missing, damaged or no such model; the message names the key, what was found and expected. Or the
            UV file is of another mesh.
    """
    path = Path(path)
    if shape_count < 0:
        raise InputError("shape_count", str(shape_count), "0 or more")
    found = _read(path)
    template = _dense(path, "v_template", found, (None, 3))
    count = len(template)
    weights = _dense(path, "weights", found, (count, None))
    joint_count = weights.shape[1]
    regressor = _dense(path, "J_regressor", found, (joint_count, count))
    faces = arrays.indices(f"{path}: f", arrays.regular(f"{path}: f", found["f"]), (None, 3), 0, count)
    shape_dirs = joint_dirs = pose_dirs = None
    if "shapedirs" in found and shape_count:
        shape_dirs = _dense(path, "shapedirs", found, (count, 3, None))[..., :shape_count]
        joint_dirs = np.einsum("jv,vcb->jcb", regressor, shape_dirs)
    if "posedirs" in found and pose_blend_shapes:
        pose_dirs = _dense(path, "posedirs", found, (count, 3, 9 * (joint_count - 1)))
    texels, uv_faces = _texels(uv, template, faces)
    with arrays.located("body", path):
        return Body(
            faces=faces,
            uv=texels,
            uv_faces=uv_faces,
            template=template,
            joints=regressor @ template,
            joint_names=_names(joint_count),
            parents=_parents(f"{path}: kintree_table", arrays.regular(f"{path}: kintree_table", found["kintree_table"]), joint_count),
            weights=weights,
            shape_dirs=shape_dirs,
            pose_dirs=pose_dirs,
            joint_dirs=joint_dirs,
        )


def _read(path: Path) -> dict[str, Any]:
    kind = path.suffix.lower()
    if kind == ".npz":
        found = unpickle.load_npz(path, _KEYS)
    elif kind in (".pkl", ".pickle"):
        held = unpickle.load_pickle(path)
        if not isinstance(held, dict):
            raise InputError(path, f"a pickled {type(held).__name__}", "a dict, as an SMPL model file is")
        found = {key: held[key] for key in _KEYS if key in held}
    else:
        raise InputError(path, f"the suffix {kind or 'nothing'}", "an SMPL model file, .pkl or .npz")
    for key in _REQUIRED:
        if key not in found:
            there = ", ".join(found) or "none of an SMPL model's keys"
            raise InputError(f"{path}: {key}", f"only {there}", f"an SMPL model file with {', '.join(_REQUIRED)}")
    return found


def _dense(path: Path, key: str, found: dict[str, Any], shape: tuple[int | None, ...]) -> np.ndarray:
    """The array as float64, checked."""
    value = found[key]
    if sparse.issparse(value):
        arrays.check_shape(f"{path}: {key}", value, shape)
    array = value.toarray() if sparse.issparse(value) else arrays.regular(f"{path}: {key}", value)
    arrays.floats(f"{path}: {key}", array, shape)
    return array.astype(np.float64)


def _parents(where: str, table: np.ndarray, count: int) -> np.ndarray:
    """(J,) parents by their places: the table's first row holds the parents' names, its second the joints' own."""
    arrays.check_shape(where, table, (2, count))
    if table.dtype.kind not in "iu":
        raise InputError(where, f"type {table.dtype}", "whole numbers")
    upper, own = table.astype(np.int64).tolist()
    places = {name: place for place, name in enumerate(own)}
    parents = [-1 if name in _NO_PARENT else places.get(name) for name in upper]
    if len(places) != count or None in parents:
        raise InputError(where, "a parent that is no joint, or a joint twice", "parents over joints, -1 for the root")
    return np.array(parents, dtype=np.int32)


def _names(count: int) -> tuple[str, ...]:
    return JOINT_NAMES if count == len(JOINT_NAMES) else tuple(f"joint{j:02d}" for j in range(count))


def _texels(uv: str | os.PathLike[str] | None, template: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if uv is not None:
        return read_uv(uv).over(faces, len(template))
    from ndf_mi.body.atlas import one_piece

    atlas = one_piece(template, faces)
    return atlas.uv, atlas.uv_faces
