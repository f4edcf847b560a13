"""Where training through scattering takes place: one scene of lights and a performer that moves, and one kernel for all of its frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from ndf_mi.capture.camera import Camera
from ndf_mi.errors import InputError
from ndf_mi.mitsuba_mesh import make_mesh, set_faces, set_vertices
from ndf_mi.model import PosedModel
from ndf_mi.projection import PosedSurface
from ndf_mi.render.bake import Baked, bake
from ndf_mi.render.shell import band_shell
from ndf_mi.run import Run

SHELL_CELL = 0.0125
"""Finest spacing in metres of the grid that a shell is cut from."""


class ScatteringScene:
    """A field on a lattice, in a tight shell, among lights.

    Each frame has a shell of its own around the body's band. They are filled up to one size with triangles of no area, and the lattice has
    one size for all frames: nothing that differs from frame to frame is compiled into a kernel.

    Args:
        run: whose body and poses they are.
        frames: the frames that there will be.
        lights: entries of a scene's dictionary.
        cell: the lattice's spacing in metres.

    Attributes:
        scene: to be traced.
    """

    def __init__(self, run: Run, frames: Sequence[int], lights: dict[str, Any], cell: float) -> None:
        preset, surface = run.model.field.preset, run.model.surface
        self._cell = cell
        self._lows: dict[int, np.ndarray] = {}
        shells, extent = {}, np.zeros(3)
        for frame in frames:
            box = run.surface(frame).bbox
            low, high = (np.array(corner, dtype=np.float64).ravel() for corner in (box.min, box.max))
            # A node of the border on each side, and room for a shift by less than a cell.
            self._lows[frame] = low - 2 * cell
            extent = np.maximum(extent, high - low)
            vertices = mi.Float(run.poses.vertices[run.poses.index(frame)].ravel())
            shells[frame] = band_shell(surface, vertices, preset.band, max(cell, SHELL_CELL), preset.band_inside)
        nx, ny, nz = (int(n) for n in np.ceil(extent / cell) + 5)
        self._shape = (nx, ny, nz)
        most = [max(len(shell[part]) for shell in shells.values()) for part in (0, 1)]
        self._shells = {frame: tuple(_filled(array, count) for array, count in zip(shell, most, strict=True))
                        for frame, shell in shells.items()}
        self._medium = mi.load_dict({"type": "ndf_lattice", "nx": nx, "ny": ny, "nz": nz, "cell": cell})
        first = next(iter(self._shells.values()))
        self.scene = mi.load_dict({"type": "scene", **lights, "performer": _shell(self._medium, *first)})
        self._parameters = mi.traverse(self.scene)
        self._frame: int | None = None

    def place(self, posed: PosedModel, frame: int, shift: np.ndarray) -> Baked:
        """Puts a field onto the lattice, and the shell around it; gradients of paths go to :meth:`gradient`.

        Args:
            posed: the field at the frame's pose, attached to its parameters.
            frame: one of the frames given.
            shift: (3,) in [0, 1), in cells: where between the field's points the nodes are.
        """
        low = mi.Point3f(*(float(v) for v in self._lows[frame] + self._cell * shift))
        dr.make_opaque(low)
        baked = bake(posed, low, self._cell, self._shape)
        self._nodes = mi.Float(baked.nodes)
        dr.enable_grad(self._nodes)
        self._medium.fill(self._nodes, low, baked.densest)
        if frame != self._frame:
            vertices, faces = self._shells[frame]
            set_vertices(self._parameters, vertices, "performer")
            set_faces(self._parameters, faces, "performer")
            self._parameters.update()
            self._frame = frame
        return baked

    def gradient(self) -> mi.Float:
        """What paths have added to the gradients of the lattice's nodes since the last :meth:`place`."""
        return dr.grad(self._nodes)


def expect_outside(run: Run, camera: Camera, frame: int, cell: float = SHELL_CELL) -> None:
    """Raises InputError where a camera may be inside the shell around a frame's band: paths along rays of our own begin outside of media,
    and would not see what lies between the camera and the next shell.

    Args:
        cell: spacing in metres of the grid that the shell is cut from, or of the lattice.
    """
    # The shell keeps within two cells' diagonals of the band.
    reach = run.model.band + 2 * math.sqrt(3) * max(cell, SHELL_CELL)
    vertices = run.poses.vertices[run.poses.index(frame)]
    position = np.asarray(camera.position, dtype=np.float32)
    if (position < vertices.min(0) - reach).any() or (position > vertices.max(0) + reach).any():
        return
    with dr.suspend_grad():
        found = PosedSurface(run.model.surface, mi.Float(vertices.ravel()), reach).project(mi.Point3f(position.tolist()))
        if not found.valid[0]:
            return
    raise InputError(f"camera {camera.name!r}, frame {frame}", f"a place {100 * found.l[0]:.1f} cm off the body, inside the performer's "
                     "band or its shell", f"a camera at least {100 * reach:.1f} cm away from the body: paths begin outside of media",
                     "Leave the camera or the frame out of the split.")


def _filled(array: np.ndarray, count: int) -> np.ndarray:
    """(count, 3): the rows of an array and then zeros: vertices that nothing uses, triangles without area."""
    return np.concatenate([array, np.zeros((count - len(array), 3), dtype=array.dtype)])


def _shell(medium: mi.Medium, vertices: np.ndarray, faces: np.ndarray) -> mi.Mesh:
    props = mi.Properties("ndf_shell")
    props.set_id("performer")
    props["bsdf"] = mi.load_dict({"type": "null"})
    props["interior"] = medium
    return make_mesh("performer", vertices, faces, props=props)
