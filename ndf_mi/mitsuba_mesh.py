"""Triangle meshes in Mitsuba: the only module that uses the interface of ``mi.Mesh``.

Mitsuba 3.10 replaces that interface: a mesh is built from tensors in one call, ``vertex_positions`` becomes
the (P, 3) tensor ``positions``, and the winding of the faces defines which side is the front. Here meshes
already face the way that their triangles wind. Which interface there is, is seen from ``Mesh.from_fields``,
which 3.10 adds; that branch follows the release notes and has not been run.
"""

from __future__ import annotations

from collections.abc import Mapping

import drjit as dr
import mitsuba as mi
import numpy as np


def make_mesh(name: str, vertices: np.ndarray, faces: np.ndarray, *, uv: np.ndarray | None = None,
              smooth: bool = False,
              attributes: Mapping[str, np.ndarray] | None = None,
              props: mi.Properties | None = None) -> mi.Mesh:
    """A mesh with Mitsuba's default BSDF, or with the BSDF, emitter and media in `props`.

    Args:
        name: what messages call the mesh.
        vertices: (V, 3).
        faces: (F, 3) indices; counter-clockwise triangles face the viewer.
        uv: (V, 2) texture coordinates, v upwards.
        smooth: whether shading interpolates vertex normals, which Mitsuba recomputes when vertices move.
        attributes: names that begin with ``vertex_``, with (V, d) values each.
        props: what the shape holds besides its geometry; its id becomes the shape's.
    """
    build = _build_tensors if _has_tensors() else _build_buffers
    return build(name, vertices, faces, uv, smooth, attributes or {},
                 mi.Properties() if props is None else props)


def set_vertices(parameters: mi.SceneParameters, vertices: np.ndarray | mi.Float, shape: str = "") -> None:
    """Moves the vertices of a mesh; takes effect at the next ``parameters.update()``.

    Args:
        parameters: of a scene, or of the mesh itself.
        vertices: (V, 3) or flat (3·V), world space; gradients pass.
        shape: id of the mesh in the scene; empty for the mesh's own parameters.
    """
    if _has_tensors():
        flat = _flat(mi.Float, vertices)
        parameters[_key(shape, "positions")] = mi.TensorXf(flat, (dr.width(flat) // 3, 3))
    else:
        parameters[_key(shape, "vertex_positions")] = _flat(mi.Float, vertices)


def set_normals(parameters: mi.SceneParameters, normals: np.ndarray, shape: str = "") -> None:
    """Replaces the vertex normals of a smooth mesh by (V, 3) unit vectors, as for meshes whose vertices are
    doubled at texture seams. To be called after the ``parameters.update()`` that moved the vertices, which
    recomputes normals, and followed by another."""
    flat = _flat(mi.Float, normals)
    if _has_tensors():
        parameters[_key(shape, "normals")] = mi.TensorXf(flat, normals.shape)
    else:
        parameters[_key(shape, "vertex_normals")] = flat


def set_faces(parameters: mi.SceneParameters, faces: np.ndarray, shape: str = "") -> None:
    """Replaces the triangles of a mesh by as many others, (F, 3); arguments as for :func:`set_vertices`."""
    flat = _flat(mi.UInt32, faces)
    parameters[_key(shape, "faces")] = mi.TensorXu(flat, (len(faces), 3)) if _has_tensors() else flat


def triangles(shape: mi.Shape) -> tuple[np.ndarray, np.ndarray] | None:
    """(V, 3) vertices and (F, 3) indices of any triangle mesh; None for any other shape."""
    parameters = mi.traverse(shape)
    if "positions" in parameters and "faces" in parameters:
        return parameters["positions"].numpy(), np.array(shape.geometric_faces()).reshape(-1, 3)
    if "vertex_positions" in parameters:
        vertices, faces = parameters["vertex_positions"], parameters["faces"]
        return vertices.numpy().reshape(-1, 3), faces.numpy().reshape(-1, 3)
    return None


def _has_tensors() -> bool:
    return hasattr(mi.Mesh, "from_fields")


def _build_buffers(name: str, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray | None, smooth: bool,
                   attributes: Mapping[str, np.ndarray], props: mi.Properties) -> mi.Mesh:
    mesh = mi.Mesh(name, len(vertices), len(faces), props=props, has_vertex_normals=smooth,
                   has_vertex_texcoords=uv is not None)
    for attribute, values in attributes.items():
        mesh.add_attribute(attribute, values.shape[1], np.ascontiguousarray(values, dtype=np.float32).ravel())
    parameters = mi.traverse(mesh)
    set_faces(parameters, faces)
    set_vertices(parameters, vertices)
    if uv is not None:
        parameters["vertex_texcoords"] = _flat(mi.Float, uv)
    parameters.update()
    return mesh


def _build_tensors(name: str, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray | None, smooth: bool,
                   attributes: Mapping[str, np.ndarray], props: mi.Properties) -> mi.Mesh:
    if not props.id():
        props.set_id(name)
    props["face_normals"] = not smooth
    mesh = mi.Mesh(props)
    fields = {"positions": vertices} if uv is None else {"positions": vertices, "texcoords": uv}
    mesh.from_fields(faces=mi.TensorXu(_flat(mi.UInt32, faces), faces.shape),
                     **{field: mi.TensorXf(_flat(mi.Float, values), values.shape)
                        for field, values in fields.items()})
    for attribute, values in attributes.items():
        mesh.add_attribute(attribute, mi.TensorXf(_flat(mi.Float, values), values.shape))
    return mesh


def _flat(kind: type, values: np.ndarray | mi.Float) -> mi.Float | mi.UInt32:
    """`values` as one flat array of `kind`."""
    if not isinstance(values, np.ndarray):
        return values
    return kind(np.ascontiguousarray(values, dtype=np.uint32 if kind is mi.UInt32 else np.float32).ravel())


def _key(shape: str, name: str) -> str:
    return f"{shape}.{name}" if shape else name
