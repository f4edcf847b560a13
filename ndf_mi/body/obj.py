"""Wavefront OBJ with named groups of quads or triangles, as MakeHuman's base mesh is written."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Group:
    """The triangles of one ``g`` group: (F, 3) vertices and, corner by corner, (F, 3) texel coordinates."""

    faces: np.ndarray
    uv_faces: np.ndarray


def read_obj(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray, dict[str, Group]]:
    """Vertices (V, 3) and texel coordinates (U, 2), float64, and the groups by name.

    Every corner must have a texel coordinate (``f v/vt …``). A quad is cut along its shorter diagonal, so that both
    triangles keep its winding. A group named several times is one group.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is no such OBJ.
    """
    vertices: list[str] = []
    texels: list[str] = []
    corners: dict[str, list[list[str]]] = {}
    current = corners.setdefault("", [])
    for line in Path(path).read_text(encoding="utf-8").splitlines():
        kind, _, rest = line.partition(" ")
        if kind == "v":
            vertices.append(rest)
        elif kind == "vt":
            texels.append(rest)
        elif kind == "f":
            current.append(rest.split())
        elif kind == "g":
            current = corners.setdefault(rest.strip(), [])
    points = np.array(" ".join(vertices).split(), dtype=np.float64).reshape(len(vertices), -1)[:, :3]
    uv = np.array(" ".join(texels).split(), dtype=np.float64).reshape(len(texels), -1)[:, :2]
    return points, uv, {name: _triangulate(polygons, points) for name, polygons in corners.items() if polygons}


def _triangulate(polygons: list[list[str]], points: np.ndarray) -> Group:
    triangles = [p for p in polygons if len(p) == 3]
    quads = [p for p in polygons if len(p) == 4]
    if len(triangles) + len(quads) != len(polygons):
        raise ValueError("a face with neither three nor four corners")
    cut = _corners(triangles, 3)
    whole = _corners(quads, 4)
    ends = points[whole[..., 0]]
    first = np.linalg.norm(ends[:, 0] - ends[:, 2], axis=1) <= np.linalg.norm(ends[:, 1] - ends[:, 3], axis=1)
    order = np.where(first[:, None], [[0, 1, 2, 0, 2, 3]], [[0, 1, 3, 1, 2, 3]])
    split = np.take_along_axis(whole, order[..., None], axis=1).reshape(-1, 3, 2)
    both = np.concatenate([cut, split])
    return Group(faces=both[..., 0], uv_faces=both[..., 1])


def _corners(polygons: list[list[str]], size: int) -> np.ndarray:
    """(P, size, 2) int64: vertex and texel of each corner, from 0."""
    pairs = [corner.split("/")[:2] for polygon in polygons for corner in polygon]
    return np.array(pairs, dtype=np.int64).reshape(-1, size, 2) - 1
