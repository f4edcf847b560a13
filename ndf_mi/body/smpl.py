"""SMPL's model files (Loper et al. 2015) as bodies. The files are licensed separately and not included.

A file's ``v_template``, ``shapedirs``, ``posedirs``, ``J_regressor``, ``weights`` and ``kintree_table`` are
T̄, S, P, 𝒥, 𝒲 and the kinematic tree of equations 2 to 10 of the paper. Rest joints are 𝒥(T̄ + S·β), which is
linear in β: the body stores ``joints`` = 𝒥·T̄ and ``joint_dirs`` = 𝒥·S. Here the root turns about the world's
origin (`ndf_mi.body.skinning`); in SMPL it turns about its own joint. The first three numbers of a pose must
therefore be zero.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from ndf_mi import unpickle
from ndf_mi.body import arrays
from ndf_mi.body.atlas import one_piece
from ndf_mi.body.body import Body
from ndf_mi.body.motion_smpl import LAYOUTS
from ndf_mi.body.uv_file import read_uv
from ndf_mi.errors import InputError

JOINT_NAMES = LAYOUTS[24]
"""SMPL's 24 joints. The joints of models with another number of them are numbered."""

_KEYS = ("v_template", "f", "weights", "J_regressor", "kintree_table", "shapedirs", "posedirs")
_REQUIRED = _KEYS[:5]
_NO_PARENT = (-1, 2**32 - 1)


def load_smpl(path: str | os.PathLike[str], uv: str | os.PathLike[str] | None = None, shape_count: int = 10,
              pose_blend_shapes: bool = True) -> Body:
    """Reads an SMPL model file as a body, also SMPL-like models of other sizes (SMPL+H, animals).

    Args:
        path: ``.pkl``, of Python 2 or 3, with arrays of numpy, scipy.sparse or chumpy, read without running
            anything (`ndf_mi.unpickle`); or ``.npz`` with the same keys.
        uv: a file of texture coordinates over the same vertices and triangles (`read_uv`); by default the
            body is cut open and flattened into one chart (`ndf_mi.body.atlas.one_piece`).
        shape_count: B, the number of shape coefficients to keep, or all if the file has fewer.
        pose_blend_shapes: whether to keep P; False suits fits that were made without it.

    Raises:
        InputError: the model file is missing, damaged or not such a model, with the key that is wrong; or the
            texture coordinates belong to another mesh.
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
    if uv is not None:
        uv_points, uv_faces = read_uv(uv).over(faces, count)
    else:
        atlas = one_piece(template, faces)
        uv_points, uv_faces = atlas.uv, atlas.uv_faces
    names = tuple(f"joint{j:02d}" for j in range(joint_count))
    with arrays.located("body", path):
        return Body(
            faces=faces, uv=uv_points, uv_faces=uv_faces, template=template, joints=regressor @ template,
            joint_names=JOINT_NAMES if joint_count == len(JOINT_NAMES) else names,
            parents=_parents(f"{path}: kintree_table", found["kintree_table"], joint_count),
            weights=weights, shape_dirs=shape_dirs, pose_dirs=pose_dirs, joint_dirs=joint_dirs,
        )  # fmt: skip


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
            present = ", ".join(found) or "none of an SMPL model's keys"
            raise InputError(f"{path}: {key}", f"only {present}",
                             f"an SMPL model file with {', '.join(_REQUIRED)}")
    return found


def _dense(path: Path, key: str, found: dict[str, Any], shape: tuple[int | None, ...]) -> np.ndarray:
    """The array as float64, checked for shape and finite numbers."""
    value = found[key]
    if sparse.issparse(value):
        arrays.check_shape(f"{path}: {key}", value, shape)
    array = value.toarray() if sparse.issparse(value) else arrays.regular(f"{path}: {key}", value)
    arrays.floats(f"{path}: {key}", array, shape)
    return array.astype(np.float64)


def _parents(where: str, value: Any, count: int) -> np.ndarray:
    """(J,) parents, from a table of each joint's parent (first row) and the joint itself."""
    table = arrays.regular(where, value)
    arrays.check_shape(where, table, (2, count))
    if table.dtype.kind not in "iu":
        raise InputError(where, f"type {table.dtype}", "whole numbers")
    upper, own = table.astype(np.int64).tolist()
    places = {name: place for place, name in enumerate(own)}
    parents = [-1 if name in _NO_PARENT else places.get(name) for name in upper]
    if len(places) != count or None in parents:
        raise InputError(where, "a parent that is no joint, or the same joint twice",
                         "the parent of each joint, -1 for the root")
    return np.array(parents, dtype=np.int32)
