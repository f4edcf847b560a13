"""Subjects in ZJU-MoCap's layout, written from a small model of 24 joints; its silhouettes are projected by
OpenCV.
"""

from __future__ import annotations

import functools
import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image, ImageDraw
from scipy import sparse
from scipy.spatial.transform import Rotation

cv2 = pytest.importorskip("cv2")

TREE = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
SIDE = 96
DISTORTION = np.array([-0.3, 0.12, 0.004, -0.003, 0.02])
COLOUR = np.array([200, 120, 60])


def model() -> dict[str, Any]:
    """SMPL's keys over a lopsided blob as large as a person, 162 vertices, y up, its origin at the chest."""
    mesh = trimesh.creation.icosphere(subdivisions=2)
    vertices = np.array(mesh.vertices) * [0.35, 0.9, 0.25]
    vertices[:, 0] += 0.25 * (vertices[:, 1] + 0.4) ** 2
    joints = vertices[np.random.default_rng(5).choice(len(vertices), 24, replace=False)] * 0.8
    near = np.exp(-np.square((vertices[:, None] - joints) / 0.25).sum(-1)) + 1e-6
    rng = np.random.default_rng(2)
    return {"v_template": vertices, "f": np.array(mesh.faces, dtype=np.uint32),
            "weights": near / near.sum(1, keepdims=True),
            "J_regressor": sparse.csc_matrix(near.T / near.T.sum(1, keepdims=True)),
            "kintree_table": np.array([TREE, range(24)]).astype(np.uint32),
            "shapedirs": rng.normal(size=(162, 3, 10)) * 0.004,
            "posedirs": rng.normal(size=(162, 3, 207)) * 0.004}


def posed(held: dict[str, Any], theta: np.ndarray, beta: np.ndarray, rh: np.ndarray, th: np.ndarray,
          blend: bool) -> np.ndarray:
    """(V, 3) vertices in the capture's world: R(Rh)·X(θ, β) + Th."""
    turns = Rotation.from_rotvec(theta).as_matrix()
    rest = held["v_template"] + held["shapedirs"] @ beta
    joints = held["J_regressor"] @ rest
    if blend:
        rest = rest + held["posedirs"] @ (turns[1:] - np.eye(3)).ravel()
    rotations, positions = [turns[0]], [joints[0]]
    for j in range(1, 24):
        p = TREE[j]
        rotations.append(rotations[p] @ turns[j])
        positions.append(positions[p] + rotations[p] @ (joints[j] - joints[p]))
    moved = np.stack([(rest - joints[j]) @ rotations[j].T + positions[j] for j in range(24)], 1)
    return np.einsum("vj,vjc->vc", held["weights"], moved) @ Rotation.from_rotvec(rh).as_matrix().T + th


def ring(count: int, side: int, distortion: np.ndarray) -> dict[str, list[np.ndarray]]:
    """Cameras around a performer at (0.3, -0.2, 1) in a world with z up; T in millimetres."""
    cams: dict[str, list[np.ndarray]] = {"K": [], "D": [], "R": [], "T": []}
    for i in range(count):
        angle = 2 * np.pi * i / count
        eye = np.array([0.3 + 3 * np.cos(angle), -0.2 + 3 * np.sin(angle), 1.2 + 0.3 * (-1) ** i])
        forward = np.array([0.3, -0.2, 1.0]) - eye
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        focal = 1.2 * side
        cams["K"].append(np.array([[focal, 0, 0.49 * side], [0, 1.005 * focal, 0.51 * side], [0, 0, 1]]))
        cams["D"].append(distortion[:, None].copy())
        cams["R"].append(rotation)
        cams["T"].append(-1000 * rotation @ eye[:, None])
    return cams


def picture(
    cams: dict[str, list[np.ndarray]], i: int, vertices: np.ndarray, faces: np.ndarray, side: int
) -> np.ndarray:
    """(side, side) bool: triangles as OpenCV projects their corners, filled at four times the size."""
    rotation, _ = cv2.Rodrigues(cams["R"][i])
    points, _ = cv2.projectPoints(1000 * vertices.astype(np.float64), rotation, cams["T"][i], cams["K"][i],
                                  cams["D"][i])
    canvas = Image.new("L", (4 * side, 4 * side))
    draw = ImageDraw.Draw(canvas)
    for triangle in (4 * (points[:, 0] + 0.5) - 0.5)[faces]:
        draw.polygon([tuple(p) for p in triangle], fill=255)
    return np.asarray(canvas.resize((side, side), Image.Resampling.BOX)) > 127


def name_of(number: int, camera: int, pattern: str) -> str:
    """An image's path in ``annots.npy``: as 313 and 315 have it, or as the others do."""
    if pattern == "numbered":
        name = f"Camera_({camera + 1})_{number:04d}_2019-08-23_16-08-50.592.jpg"
        return f"Camera ({camera + 1})/CoreView_313_{name}"
    return f"Camera_B{camera + 1}/{number:06d}.jpg"


@pytest.fixture(scope="session")
def smpl_file(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The model's file, and texture coordinates for it."""
    folder = tmp_path_factory.mktemp("smpl")
    held = model()
    (folder / "smpl.pkl").write_bytes(pickle.dumps(held, 2))
    faces = held["f"].astype(np.int32)
    uv = np.random.default_rng(0).random((faces.size, 2)).astype(np.float32)
    np.savez(folder / "uv.npz", uv=uv, uv_faces=np.arange(faces.size).reshape(-1, 3), faces=faces)
    return folder / "smpl.pkl", folder / "uv.npz"


def write_subject(
    root: Path, name: str, count: int, numbers: Sequence[int], rows: Sequence[int] = (),
    cameras: Sequence[int] | Callable[[int], Sequence[int]] | None = None, *,
    pattern: str = "stem", fits: str = "new_params", masks: str = "mask_cihp", entries: int = 72,
    side: int = SIDE, stored: bool = True, calibrated: int | None = None, undistorted: bool = False,
) -> SimpleNamespace:  # fmt: skip
    """Writes a subject's folder: all of ``annots.npy``, and of the rest what the rows and cameras (those of
    a row, if they are a function) need.
    """
    folder = root / name
    folder.mkdir()
    distortion = np.zeros(5) if undistorted else DISTORTION
    cams = ring(count, calibrated or side, distortion)
    ims = [{"ims": [name_of(number, camera, pattern) for camera in range(count)]} for number in numbers]
    np.save(folder / "annots.npy", {"cams": cams, "ims": ims}, allow_pickle=True)
    (folder / fits).mkdir()
    held = model()
    drawn = cams if calibrated is None else ring(count, side, distortion)
    truth = {}
    for row in rows:
        number = numbers[row]
        rng = np.random.default_rng(row)
        theta = rng.normal(size=(24, 3)) * 0.15
        theta[0] = 0
        beta = np.random.default_rng(9).normal(size=10)
        # Upright in a world with z up, then turned about it.
        rh = (Rotation.from_euler("z", 0.4 + 0.1 * row) * Rotation.from_euler("x", np.pi / 2)).as_rotvec()
        th = np.array([0.3, -0.2, 1.0]) + rng.normal(size=3) * 0.03
        vertices = posed(held, theta, beta, rh, th, fits == "new_params")
        truth[number] = vertices
        fit = {"poses": theta.reshape(1, 72)[:, 72 - entries :], "shapes": beta[None], "Rh": rh[None],
               "Th": th[None]}
        np.save(folder / fits / f"{number}.npy", fit, allow_pickle=True)
        if stored:
            place = folder / fits.replace("params", "vertices")
            place.mkdir(exist_ok=True)
            np.save(place / f"{number}.npy", vertices.astype(np.float32))
        for camera in range(count) if cameras is None else cameras(row) if callable(cameras) else cameras:
            mask = picture(drawn, camera, vertices, held["f"], side)
            image = folder / name_of(number, camera, pattern)
            label = folder / masks / Path(name_of(number, camera, pattern)).with_suffix(".png")
            for file in (image, label):
                file.parent.mkdir(parents=True, exist_ok=True)
            pixels = np.where(mask[..., None], COLOUR, [30, 90, 30]).astype(np.uint8)
            Image.fromarray(pixels).save(image, quality=98, subsampling=0)
            Image.fromarray(np.where(mask, np.uint8(1 + row % 19), np.uint8(0))).save(label)
    return SimpleNamespace(folder=folder, cams=cams, truth=truth, faces=held["f"])


@pytest.fixture
def write_zju(tmp_path: Path) -> Callable[..., SimpleNamespace]:
    """`write_subject` into the folder of a test."""
    return functools.partial(write_subject, tmp_path)


@pytest.fixture(scope="session")
def small_subject(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A subject of 19 cameras and 500 frames, with the files of two of each; to be copied."""
    return write_subject(tmp_path_factory.mktemp("zju"), "CoreView_377", 19, range(500), (0, 300), (0, 6),
                         side=32)
