"""SMPL's files, written here with a small model of random numbers, against the published equations in plain
numpy.
"""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import sparse

from ndf_mi.body.atlas import Atlas, check_atlas
from ndf_mi.body.skinning import skin
from ndf_mi.body.smpl import JOINT_NAMES, load_smpl
from ndf_mi.errors import InputError

#: SMPL's tree: the parent of each of the 24 joints.
TREE = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]


def model(shapes: int = 10) -> dict[str, Any]:
    """A tetrahedron-tiled blob of 60 vertices with the keys, types and sizes (but for V) of SMPL's file."""
    rng = np.random.default_rng(3)
    count, joints = 60, 24
    weights = rng.random((count, joints)) ** 8
    regressor = np.where(rng.random((joints, count)) < 0.2, rng.random((joints, count)), 0) + 1e-3
    table = np.array([TREE, range(joints)], dtype=np.int64)
    return {"v_template": rng.normal(size=(count, 3)),
            "f": rng.permuted(np.tile(np.arange(count, dtype=np.uint32), (40, 1)), axis=1)[:, :3],
            "weights": weights / weights.sum(1, keepdims=True),
            "J_regressor": sparse.csc_matrix(regressor / regressor.sum(1, keepdims=True)),
            "kintree_table": table.astype(np.uint32), "shapedirs": rng.normal(size=(count, 3, shapes)) * 0.1,
            "posedirs": rng.normal(size=(count, 3, 207)) * 0.05, "bs_style": "lbs",
            "pose_training_info": {"gender": "neutral"}}


def uv_file(path: Path, faces: np.ndarray) -> Path:
    """Separate texture coordinates for each corner."""
    uv = np.random.default_rng(1).random((3 * len(faces), 2))
    np.savez(path, uv=uv.astype(np.float32), uv_faces=np.arange(3 * len(faces)).reshape(-1, 3))
    return path


def write(path: Path, held: dict[str, Any], protocol: int = 2) -> Path:
    if path.suffix == ".npz":
        np.savez(path, **held)
    else:
        path.write_bytes(pickle.dumps(held, protocol))
    return path


def published(
    held: dict[str, Any], theta: np.ndarray, beta: np.ndarray, pose_blend_shapes: bool = True
) -> np.ndarray:
    """Loper et al. 2015, equations 2 to 4 and 6 to 10, a vertex and a joint at a time; the first joint does
    not turn.
    """

    def exponential(w: np.ndarray) -> np.ndarray:
        """Rodrigues' formula (equation 1), by the series of the matrix exponential."""
        k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        total, term = np.eye(3), np.eye(3)
        for n in range(1, 40):
            term = term @ k / n
            total = total + term
        return total

    rotations = [exponential(w) for w in theta]
    shaped = held["v_template"] + sum(b * held["shapedirs"][:, :, n] for n, b in enumerate(beta))  # eq. 7, 8
    joints = held["J_regressor"].toarray() @ shaped  # eq. 10
    rest = shaped.copy()
    if pose_blend_shapes:  # eq. 9
        for k in range(23):
            for m, value in enumerate((rotations[k + 1] - np.eye(3)).ravel()):
                rest += value * held["posedirs"][:, :, 9 * k + m]
    world: list[np.ndarray] = []
    for k, parent in enumerate(TREE):  # eq. 4
        local = np.eye(4)
        local[:3, :3], local[:3, 3] = rotations[k], joints[k]
        if parent >= 0:
            local[:3, 3] -= joints[parent]
        world.append(local if parent < 0 else world[parent] @ local)
    result = np.zeros_like(rest)
    for i, x in enumerate(rest):  # eq. 2, 3, 6
        for k in range(24):
            undo = np.eye(4)
            undo[:3, 3] = -joints[k]
            result[i] += held["weights"][i, k] * (world[k] @ undo @ [*x, 1.0])[:3]
    return result


def vertices(flat: Any) -> np.ndarray:
    return np.array(flat, dtype=np.float64).reshape(-1, 3)


@pytest.mark.parametrize("suffix", [".pkl", ".npz"])
@pytest.mark.parametrize("pose_blend_shapes", [True, False])
def test_skinning_is_the_published_equation(tmp_path: Path, suffix: str, pose_blend_shapes: bool) -> None:
    held = model()
    path = write(tmp_path / f"smpl{suffix}", held)
    body = load_smpl(path, uv_file(tmp_path / "uv.npz", held["f"]), pose_blend_shapes=pose_blend_shapes)
    rng = np.random.default_rng(0)
    theta, beta = rng.normal(size=(24, 3)) * 0.5, rng.normal(size=10)
    theta[0] = 0
    expected = published(held, theta, beta, pose_blend_shapes)
    np.testing.assert_allclose(vertices(skin(body, theta, np.zeros(3), np.zeros(3), beta)), expected,
                               atol=2e-5)
    # The root: a third of a turn about (1, 1, 1) takes x to y, y to z and z to x, about the origin.
    turned = skin(body, theta, np.full(3, 2 * np.pi / 3 / np.sqrt(3)), [1, 2, 3], beta)
    np.testing.assert_allclose(vertices(turned), expected[:, [2, 0, 1]] + [1, 2, 3], atol=2e-5)


def test_fields(tmp_path: Path) -> None:
    held = model(300)
    body = load_smpl(write(tmp_path / "smpl.pkl", held), uv_file(tmp_path / "uv.npz", held["f"]))
    assert body.joint_names == JOINT_NAMES and body.parents is not None and body.parents.tolist() == TREE
    assert body.shape_count == 10 and body.joint_dirs is not None and body.shape_dirs is not None
    np.testing.assert_allclose(body.shape_dirs, held["shapedirs"][..., :10], rtol=1e-6)
    np.testing.assert_array_equal(body.faces, held["f"])
    assert load_smpl(tmp_path / "smpl.pkl", tmp_path / "uv.npz", shape_count=16).shape_count == 16
    assert load_smpl(tmp_path / "smpl.pkl", tmp_path / "uv.npz", shape_count=0).shape_dirs is None


def test_the_tree_goes_by_names_not_places(tmp_path: Path) -> None:
    held = model()
    held["kintree_table"] = np.where(
        held["kintree_table"] > 1000, 2**32 - 1, held["kintree_table"] + 100
    ).astype(np.int64)
    held["J_regressor"] = held["J_regressor"].toarray()
    body = load_smpl(write(tmp_path / "smpl.npz", held), uv_file(tmp_path / "uv.npz", held["f"]))
    assert body.parents is not None and body.parents.tolist() == TREE


def test_texels_of_an_obj_in_another_order(tmp_path: Path) -> None:
    """Triangles and corners stand otherwise in the file; each corner of the body's must get its own."""
    held = model()
    faces = held["f"].astype(int)
    rng = np.random.default_rng(4)
    uv_of = {
        (tuple(sorted(face)), vertex): rng.random(2).round(6) for face in faces.tolist() for vertex in face
    }
    lines = [f"v {x} {y} {z}" for x, y, z in held["v_template"]]
    corners = []
    for i in rng.permutation(len(faces)):
        face = np.roll(faces[i], rng.integers(3)).tolist()
        for vertex in face:
            corners.append((vertex, uv_of[tuple(sorted(face)), vertex]))
    lines += [f"vt {u} {v}" for _, (u, v) in corners]
    for i in range(0, len(corners), 3):
        lines.append("f " + " ".join(f"{corners[i + c][0] + 1}/{i + c + 1}" for c in range(3)))
    (tmp_path / "uv.obj").write_text("\n".join(lines))
    body = load_smpl(write(tmp_path / "smpl.pkl", held), tmp_path / "uv.obj")
    for face, uv_corners in zip(body.faces.tolist(), body.uv_faces, strict=True):
        for vertex, uv_corner in zip(face, uv_corners, strict=True):
            np.testing.assert_allclose(body.uv[uv_corner], uv_of[tuple(sorted(face)), vertex], atol=1e-6)


def test_without_a_uv_file_the_body_gets_one_chart(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(1)
    held = model()
    held["f"] = np.array(ball.faces, dtype=np.uint32)
    held["v_template"][: len(ball.vertices)] = ball.vertices
    body = load_smpl(write(tmp_path / "smpl.pkl", held))
    report = check_atlas(body.template, body.faces, Atlas(body.uv, body.uv_faces))
    assert report.valid and report.charts == 1


SPOILT: dict[str, tuple[dict[str, Any], str]] = {
    "no weights": ({"weights": None}, "weights: found only v_template"),
    "another number of vertices": (
        {"weights": np.full((50, 24), 1 / 24)},
        r"weights: found shape \(50, 24\); expected shape \(60, any\)",
    ),
    "another number of joints": (
        {"J_regressor": np.full((52, 60), 1 / 60)},
        r"J_regressor: found shape \(52, 60\)",
    ),
    "a short tree": (
        {"kintree_table": np.zeros((2, 23), np.uint32)},
        r"kintree_table: found shape \(2, 23\)",
    ),
    "a tree of strangers": ({"kintree_table": np.full((2, 24), 5)}, "kintree_table: found a parent"),
    "faces of another mesh": ({"f": np.array([[0, 1, 6889]])}, "f: found values from 0 to 6889"),
    "pose directions of another model": (
        {"posedirs": np.zeros((60, 3, 459))},
        r"posedirs: found shape \(60, 3, 459\)",
    ),
    "ragged vertices": (
        {"v_template": [[0.0, 1.0, 2.0]] * 59 + [[0.0]]},
        "v_template: found rows of unequal length",
    ),
    "ragged faces": ({"f": [[0, 1, 2], [0, 1]]}, "f: found rows of unequal length"),
    "a ragged tree": ({"kintree_table": [[0] * 24, [1] * 23]}, "kintree_table: found rows of unequal length"),
    "NaN": ({"v_template": np.full((60, 3), np.nan)}, "v_template: found 180 values not finite"),
    "weights that do not add up": ({"weights": np.full((60, 24), 0.1)}, "weights: found .* sums to"),
}


@pytest.mark.parametrize("case", SPOILT)
def test_refuses(tmp_path: Path, case: str) -> None:
    changes, words = SPOILT[case]
    held = model()
    uv = uv_file(tmp_path / "uv.npz", held["f"])
    held = {key: value for key, value in {**held, **changes}.items() if value is not None}
    with pytest.raises(InputError, match=f"smpl.pkl: {words}"):
        load_smpl(write(tmp_path / "smpl.pkl", held), uv)


def test_refuses_other_files(tmp_path: Path) -> None:
    held = model()
    path = write(tmp_path / "smpl.pkl", held)
    with pytest.raises(InputError, match="smplx.json: found the suffix .json"):
        load_smpl(tmp_path / "smplx.json")
    with pytest.raises(InputError, match="none.npz: found no such file"):
        load_smpl(tmp_path / "none.npz")
    (tmp_path / "list.pkl").write_bytes(pickle.dumps([1]))
    with pytest.raises(InputError, match="list.pkl: found a pickled list"):
        load_smpl(tmp_path / "list.pkl")
    with pytest.raises(InputError,
                       match="uv.npz: found 39 triangles; expected .* 60 vertices and 40 triangles"):
        load_smpl(path, uv_file(tmp_path / "uv.npz", held["f"][1:]))
    np.savez(tmp_path / "other.npz", uv=np.zeros((1, 2)), uv_faces=np.zeros((40, 3), int),
             faces=held["f"][:, ::-1].astype(int))
    with pytest.raises(InputError, match="other.npz: found other triangles"):
        load_smpl(path, tmp_path / "other.npz")
    (tmp_path / "no.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match="no.obj: found no mesh with texture coordinates"):
        load_smpl(path, tmp_path / "no.obj")
