"""The shape plugin ``ndf_shell``."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.plugins.ndf import find_run, frame_of
from ndf_mi.render.shell import band_shell
from ndf_mi.run import Run


def make_shell(props: mi.Properties) -> mi.Mesh:
    r"""
    .. _shape-ndf_shell:

    Shell of a neural deformable field (:monosp:`ndf_shell`)
    --------------------------------------------------------

    A closed triangle mesh tightly around the band of a run's body at a frame, made when the scene is loaded. Give it a ``null``
    BSDF and an ``ndf`` medium as its interior.

    .. pluginparameters::

     * - run
       - |string|
       - Folder of the run, as for the medium ``ndf``.
     * - frame
       - |int|
       - Frame whose pose it follows. (Default: the run's first)
     * - cell
       - |float|
       - Spacing in metres of the grid that it is cut from: smaller is tighter and has more triangles. (Default: 0.02)

    - Contains every point of the band; where the body is thick enough, its empty inside is left out.
    - The mesh is in the performer's own world coordinates: it takes no ``to_world``.
    """
    run = Run.load(find_run(props["run"]))
    row = run.poses.index(frame_of(run, props))
    cell = float(props.get("cell", 0.02))
    if not cell > 0:
        raise InputError("ndf_shell: cell", repr(cell), "a length above 0, in metres")
    if "to_world" in props:
        raise InputError("ndf_shell: to_world", "a transformation", "none: the shell is where the performer is")
    vertices, faces = band_shell(run.model.surface, mi.Float(run.poses.vertices[row].ravel()), run.model.band, cell)
    mesh = mi.Mesh("ndf_shell", len(vertices), len(faces), props=props)
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(np.ascontiguousarray(vertices).ravel())
    params["faces"] = mi.UInt32(np.ascontiguousarray(faces).ravel())
    params.update()
    return mesh


def register() -> None:
    """Registers the plugin for the active variant."""
    mi.register_shape("ndf_shell", make_shell)
