"""Wavefront OBJ: triangles or quads in named groups, with texture coordinates at each corner.

trimesh's reader loses either the numbers of the vertices or the seams of the texture.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

Corner = tuple[int, int]
"""Vertex and texture coordinates, both counted from 0."""


@dataclass(frozen=True)
class Group:
    """The triangles of a ``g`` group: (F, 3) indices of vertices, and (F, 3) of UVs."""

    faces: np.ndarray
    uv_faces: np.ndarray


def read_obj(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray, dict[str, Group]]:
    """Vertices (V, 3) and texture coordinates (U, 2), float64, and the groups by name.

    Every corner must have texture coordinates (``f v/vt …``); negative indices count back from the last
    vertex so far. Quads are cut along their shorter diagonal. Groups of the same name are one group.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is not such an OBJ; the message has the line.
    """
    vertices: list[list[float]] = []
    uv: list[list[float]] = []
    polygons: dict[str, list[list[Corner]]] = {}
    current = polygons.setdefault("", [])
    for number, line in enumerate(Path(path).read_text(encoding="utf-8").splitlines(), start=1):
        kind, *words = line.partition("#")[0].split() or [""]
        try:
            if kind == "v":
                x, y, z = map(float, words[:3])
                vertices.append([x, y, z])
            elif kind == "vt":
                u, v = map(float, words[:2])
                uv.append([u, v])
            elif kind == "f":
                if len(words) not in (3, 4):
                    raise ValueError(f"a face with {len(words)} corners, neither three nor four")
                current.append([_corner(word, len(vertices), len(uv)) for word in words])
            elif kind == "g":
                current = polygons.setdefault(" ".join(words), [])
        except ValueError as error:
            raise ValueError(f"line {number}: {error}") from None
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    groups = {name: _triangulate(faces, points) for name, faces in polygons.items() if faces}
    return points, np.array(uv, dtype=np.float64).reshape(-1, 2), groups


def _corner(word: str, vertices: int, uv: int) -> Corner:
    """Reads ``v/vt`` or ``v/vt/vn`` after so many vertices and texture coordinates."""
    parts = word.split("/")
    if len(parts) < 2 or not parts[1]:
        raise ValueError(f"the corner {word!r} without texture coordinates")
    v, vt = (index - 1 if (index := int(part)) > 0 else count + index
             for part, count in zip(parts, (vertices, uv), strict=False))
    if min(v, vt) < 0 or "0" in (parts[0], parts[1]):
        raise ValueError(f"the corner {word!r}, which names nothing before it")
    return v, vt


def _triangulate(polygons: list[list[Corner]], points: np.ndarray) -> Group:
    """Triangles first, then the halves of the quads, with their winding."""
    triangles = np.array([p for p in polygons if len(p) == 3], dtype=np.int64).reshape(-1, 3, 2)
    quads = np.array([p for p in polygons if len(p) == 4], dtype=np.int64).reshape(-1, 4, 2)
    ends = points[quads[..., 0]]
    first = np.linalg.norm(ends[:, 0] - ends[:, 2], axis=1) <= np.linalg.norm(ends[:, 1] - ends[:, 3], axis=1)
    order = np.where(first[:, None], [[0, 1, 2, 0, 2, 3]], [[0, 1, 3, 1, 2, 3]])
    halves = np.take_along_axis(quads, order[..., None], axis=1).reshape(-1, 3, 2)
    both = np.concatenate([triangles, halves])
    return Group(faces=both[..., 0], uv_faces=both[..., 1])
