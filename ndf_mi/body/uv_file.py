"""Texture coordinates in a file of their own, for a mesh that comes without: Wavefront OBJ or ``.npz``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ndf_mi.body import arrays
from ndf_mi.body.obj import read_obj
from ndf_mi.errors import InputError


@dataclass(frozen=True, eq=False)
class UVFile:
    """Texture coordinates over a mesh's triangles.

    Attributes:
        uv: (U, 2) float32 in [0, 1], v up.
        uv_faces: (F, 3) int32 into ``uv``.
        faces: (F, 3) int32, the vertices of the same triangles; None if the file does not have them.
    """

    path: Path
    uv: np.ndarray
    uv_faces: np.ndarray
    faces: np.ndarray | None

    def over(self, faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
        """``uv`` and ``uv_faces``, brought into the order of the triangles and corners of ``faces``, (F, 3).

        Raises:
            InputError: the triangles of the file are not those of the mesh, of ``vertex_count`` vertices.
        """
        mesh = f"texture coordinates of the mesh with {vertex_count} vertices and {len(faces)} triangles"
        if len(self.uv_faces) != len(faces):
            raise InputError(self.path, f"{len(self.uv_faces)} triangles", mesh)
        if self.faces is None:
            return self.uv, self.uv_faces
        mine, mine_first = _turned(self.faces)
        theirs, theirs_first = _turned(faces)
        order, wanted = np.lexsort(mine.T), np.lexsort(theirs.T)
        lacking = (mine[order] != theirs[wanted]).any(axis=1)
        if lacking.any():
            raise InputError(self.path, f"other triangles, {int(lacking.sum())} of them", mesh)
        place = np.empty(len(faces), dtype=np.int64)
        place[wanted] = order
        # Corner c of the mesh's triangle is corner c - theirs_first of the turned one, and so c -
        # theirs_first + mine_first of the file's.
        corners = (np.arange(3) - theirs_first[:, None] + mine_first[place][:, None]) % 3
        return self.uv, np.take_along_axis(self.uv_faces[place], corners, axis=1)


def read_uv(path: str | os.PathLike[str]) -> UVFile:
    """Reads texture coordinates.

    Args:
        path: an ``.obj`` whose faces (triangles or quads) have ``v/vt`` at each corner and number vertices as
            the mesh does; or an ``.npz`` with ``uv`` (U, 2), ``uv_faces`` (F, 3) and optionally ``faces`` (F,
            3), by default those of the mesh.

    Raises:
        InputError: the file is missing, damaged, without texture coordinates, or of another kind.
    """
    path = Path(path)
    kind = path.suffix.lower()
    faces: np.ndarray | None
    if kind == ".npz":
        found = arrays.read_npz(path, ("uv", "uv_faces"), ("faces",))
        uv, uv_faces, faces = found["uv"], found["uv_faces"], found.get("faces")
    elif kind == ".obj":
        try:
            _, uv, groups = read_obj(path)
            uv_faces = np.concatenate([group.uv_faces for group in groups.values()])
            faces = np.concatenate([group.faces for group in groups.values()])
        except FileNotFoundError:
            raise InputError(path, "no such file", "texture coordinates, .obj or .npz") from None
        except (OSError, ValueError, IndexError) as error:
            raise InputError(path, f"no mesh with texture coordinates ({error})",
                             "an OBJ with v/vt at each corner") from None
    else:
        raise InputError(path, f"the suffix {kind or 'nothing'}", "texture coordinates, .obj or .npz")
    uv = arrays.floats(f"{path}: uv", uv, (None, 2))
    uv_faces = arrays.indices(f"{path}: uv_faces", uv_faces, (None, 3), 0, max(1, len(uv)))
    if faces is not None:
        faces = arrays.indices(f"{path}: faces", faces, (len(uv_faces), 3), 0, np.iinfo(np.int32).max)
    return UVFile(path, uv, uv_faces, faces)


def _turned(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles turned so that the lowest vertex comes first, and (F,) the corner where it was."""
    first = faces.argmin(axis=1)
    return np.take_along_axis(faces, (first[:, None] + np.arange(3)) % 3, axis=1), first
