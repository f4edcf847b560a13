"""The shape plugin ``ndf_shell``."""

from __future__ import annotations

import mitsuba as mi

from ndf_mi.errors import InputError
from ndf_mi.mitsuba_mesh import make_mesh
from ndf_mi.render import properties
from ndf_mi.render.performers import FieldMedium
from ndf_mi.render.shell import band_shell


def make_shell(props: mi.Properties) -> mi.Object:
    r"""
    .. _shape-ndf_shell:

    Shell of a neural deformable field (:monosp:`ndf_shell`)
    --------------------------------------------------------

    A closed triangle mesh tightly around the band of a run's body at a frame, made when the scene is loaded.
    With ``layers``, several of them, one within the other, between which the medium has local majorants. Give
    it an ``ndf`` medium as its interior.

    .. pluginparameters::

     * - run
       - |string|
       - Folder of the run, as for the medium ``ndf``. (Default: the interior medium's)
     * - frame
       - |int|
       - Frame whose pose it follows. (Default: the interior medium's, or without one the run's first)
     * - offset
       - |vector|
       - Where the performer stands relative to the run, in metres. (Default: the interior medium's, or
         without one 0, 0, 0)
     * - layers
       - |int|
       - Largest number of nested shells; 0 for a single one, in which the medium keeps the majorant that
         holds by construction. Fewer are made where more would not pay. 4 is a good number for a trained
         field. (Default: 0)
     * - cell
       - |float|
       - Spacing in metres of the grid that the shell is cut from: a smaller one gives a tighter shell with
         more triangles, and takes longer. (Default: 0.0125)
     * - (Nested plugin)
       - |bsdf|
       - What the shell itself looks like. (Default: null)
     * - interior, exterior
       - |medium|
       - The ``ndf`` medium, and the medium around the shell, if any.

    - Contains every point of the band. Where the body is thick enough, its inside deeper than ``band_inside``
      is left out.
    - The mesh is where the performer is, and faces outward: it accepts no ``to_world`` and no
      ``flip_normals``. To move it, set the ``offset`` of the medium.
    - With ``layers``, the majorants are estimated from samples of the density. A check at other points raises
      those that it finds exceeded, and logs a warning. They are estimated again when the medium's parameters
      change, unless gradients of these are enabled. The first shape keeps the plugin's id, the others have
      ``_1``, ``_2`` … added; the parameters belong to the first one's medium.
    - Two performers whose shells meet are not handled, as with other shapes that hold media in Mitsuba.

    .. tabs::
        .. code-tab:: xml

            <shape type="ndf_shell" id="performer">
                <integer name="layers" value="4"/>
                <medium type="ndf" name="interior">
                    <string name="run" value="runs/studio"/>
                </medium>
            </shape>
    """
    layers, cell = int(props.get("layers", 0)), float(props.get("cell", 0.0125))
    if layers < 0 or layers > 16:
        raise InputError("ndf_shell: layers", str(layers), "a whole number from 0 to 16")
    if not 0 < cell < float("inf"):
        raise InputError("ndf_shell: cell", repr(cell), "a length above 0, in metres")
    if "to_world" in props:
        expected = "none: the shell is where the performer is"
        raise InputError("ndf_shell: to_world", "a transformation", expected,
                         "Move the performer by the medium's `offset`.")
    if "flip_normals" in props:
        raise InputError("ndf_shell: flip_normals", str(props["flip_normals"]).lower(),
                         "none: the shell faces outward, as media need")
    medium = props["interior"] if "interior" in props else None
    field = medium.neural_field if isinstance(medium, FieldMedium) else None
    if "run" in props:
        run = properties.run(props)
        frame = properties.frame(run, props)
    elif field is not None:
        run, frame = field.run, int(props.get("frame", field.frame))
    else:
        raise InputError("ndf_shell: run", "nothing", "the run's folder, or an `ndf` medium as its interior")
    if field is not None and (frame != field.frame or run.path.resolve() != field.run.path.resolve()):
        found = f"a medium of {field.run.path}, frame {field.frame}"
        expected = f"one of {run.path}, frame {frame}"
        raise InputError("ndf_shell: interior", found, expected,
                         "Leave out the shell's run and frame: it takes those of its medium.")
    offset = properties.offset(run, props) if field is None or "offset" in props else field.offset
    if field is not None and (offset != field.offset).any():
        found = f"a medium with the offset {field.offset.tolist()}"
        raise InputError("ndf_shell: interior", found, f"one with {offset.tolist()}",
                         "Leave out the shell's offset: it takes that of its medium.")
    bsdf = _bsdf(props)
    if layers == 0:
        preset = run.model.field.preset
        if field is None:
            vertices = mi.Float((run.poses.vertices[run.poses.index(frame)] + offset).ravel())
        else:
            vertices = field.vertices
        shell = band_shell(run.model.surface, vertices, preset.band, cell, preset.band_inside,
                           run.model.bands)
        return make_mesh("ndf_shell", *shell, props=props)
    if field is None:
        found = f"{layers} around no `ndf` medium"
        raise InputError("ndf_shell: layers", found, "an `ndf` medium as its interior")
    shells, media = field.nest(layers, cell)
    # A plugin makes one object. Mitsuba's own `merge` is one that stands for several shapes.
    group = mi.Properties("merge")
    for index, (vertices, faces) in enumerate(shells):
        own = mi.Properties("ndf_shell")
        own.set_id(props.id() if index == 0 else f"{props.id()}_{index}")
        own["bsdf"] = bsdf
        own["interior"] = media[index]
        if index > 0:
            own["exterior"] = media[index - 1]
        elif "exterior" in props:
            own["exterior"] = props["exterior"]
        group[f"shell_{index}"] = make_mesh("ndf_shell", vertices, faces, props=own)
    return mi.PluginManager.instance().create_object(group)


def _bsdf(props: mi.Properties) -> mi.BSDF:
    """The BSDF among the properties; without one, a null BSDF, which is added to them."""
    for name in props.keys():  # noqa: SIM118 (properties are no mapping)
        if isinstance(props[name], mi.BSDF):
            return props[name]
    props["bsdf"] = mi.PluginManager.instance().create_object(mi.Properties("null"))
    return props["bsdf"]


def register() -> None:
    """Registers the plugin for the active variant."""
    mi.register_shape("ndf_shell", make_shell)
