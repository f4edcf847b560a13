"""The scene for training through scattering: lights, a moving performer, one kernel for all frames."""

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
from ndf_mi.render.bake import NodeSamples, bake
from ndf_mi.render.shell import band_shell
from ndf_mi.run import Run

SHELL_CELL = 0.0125
"""Finest spacing in metres of the grid that a shell is extracted from."""


class ScatteringScene:
    """A field sampled on a grid, inside a tight shell, among lights.

    Each frame has its own shell around the body's band. All shells are padded to one size with degenerate
    triangles, and the grid has one size for all frames, so that no kernel depends on the frame.

    Args:
        run: provides the body and its poses.
        frames: all frames that will be placed.
        lights: entries of a scene's dictionary.
        cell: the grid's spacing in metres.

    Attributes:
        scene: the Mitsuba scene.
    """

    def __init__(self, run: Run, frames: Sequence[int], lights: dict[str, Any], cell: float) -> None:
        preset, surface = run.model.field.preset, run.model.surface
        self._cell = cell
        self._lows: dict[int, np.ndarray] = {}
        shells, extent = {}, np.zeros(3)
        for frame in frames:
            box = run.surface(frame).bbox
            low, high = (np.array(corner, dtype=np.float64).ravel() for corner in (box.min, box.max))
            # One node for the border on each side, and room for a shift by less than a cell.
            self._lows[frame] = low - 2 * cell
            extent = np.maximum(extent, high - low)
            vertices = mi.Float(run.poses.vertices[run.poses.index(frame)].ravel())
            shells[frame] = band_shell(surface, vertices, preset.band, max(cell, SHELL_CELL),
                                       preset.band_inside, run.model.bands)
        nx, ny, nz = (int(n) for n in np.ceil(extent / cell) + 5)
        self._shape = (nx, ny, nz)
        largest = [max(len(shell[part]) for shell in shells.values()) for part in (0, 1)]
        # The added rows are unused vertices and degenerate triangles.
        self._shells = {frame: [np.pad(array, ((0, count - len(array)), (0, 0)))
                                for array, count in zip(shell, largest, strict=True)]
                        for frame, shell in shells.items()}
        self._medium = mi.load_dict({"type": "ndf_grid", "nx": nx, "ny": ny, "nz": nz, "cell": cell})
        props = mi.Properties("ndf_shell")
        props.set_id("performer")
        props["bsdf"] = mi.load_dict({"type": "null"})
        props["interior"] = self._medium
        performer = make_mesh("performer", *next(iter(self._shells.values())), props=props)
        self.scene = mi.load_dict({"type": "scene", **lights, "performer": performer})
        self._parameters = mi.traverse(self.scene)
        self._frame: int | None = None

    def place(self, posed: PosedModel, frame: int, shift: np.ndarray) -> tuple[NodeSamples, mi.Float]:
        """Evaluates a field on the grid and moves the shell around it.

        Args:
            posed: the field at the frame's pose, attached to its parameters.
            frame: one of the frames given at construction.
            shift: (3,) in [0, 1): the grid's offset in cells.

        Returns:
            the field at the grid's nodes, and the nodes that paths see; replayed paths add
            to their gradients.
        """
        low = mi.Point3f(*(float(v) for v in self._lows[frame] + self._cell * shift))
        dr.make_opaque(low)
        samples, nodes, densest = bake(posed, low, self._cell, self._shape)
        nodes = mi.Float(nodes)
        dr.enable_grad(nodes)
        self._medium.fill(nodes, low, densest)
        if frame != self._frame:
            vertices, faces = self._shells[frame]
            set_vertices(self._parameters, vertices, "performer")
            set_faces(self._parameters, faces, "performer")
            self._parameters.update()
            self._frame = frame
        return samples, nodes


def expect_outside(run: Run, camera: Camera, frame: int, cell: float = SHELL_CELL) -> None:
    """Raises InputError where a camera may be inside the shell around a frame's band.

    Our integrators start paths outside of all media. From inside a shell they would miss what lies between
    the camera and the next surface.

    Args:
        cell: spacing in metres of the grid that the shell is extracted from.
    """
    # The shell stays within two cells' diagonals of the band.
    shell = 2 * math.sqrt(3) * max(cell, SHELL_CELL)
    reach = run.model.band + shell
    vertices = run.poses.vertices[run.poses.index(frame)]
    position = np.asarray(camera.position, dtype=np.float32)
    if (position < vertices.min(0) - reach).any() or (position > vertices.max(0) + reach).any():
        return
    with dr.suspend_grad():
        posed, at = (PosedSurface(run.model.surface, mi.Float(vertices.ravel()), reach),
                     mi.Point3f(position.tolist()))
        found, bands = posed.project(at), run.model.bands
        if not found.valid[0] or (bands is not None and not posed.within_bands(at, bands, shell)[0][0]):
            return
    raise InputError(
        f"camera {camera.name!r}, frame {frame}",
        f"a position {100 * found.l[0]:.1f} cm off the body, inside the performer's band or its shell",
        f"a camera at least {100 * reach:.1f} cm from the body, because paths start outside of media",
        "Remove the camera or the frame from the split.")
