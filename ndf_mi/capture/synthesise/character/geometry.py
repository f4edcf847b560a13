"""The surfaces of a glTF character: vertices with the nodes that move them, triangles and base colours."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from msgspec import Struct
from scipy.sparse import csr_matrix

from ndf_mi.capture.synthesise.character.animation import Nodes
from ndf_mi.capture.synthesise.character.buffers import Buffers
from ndf_mi.capture.synthesise.character.document import (
    Document,
    Finite,
    Index,
    Material,
    Primitive,
    Skin,
    TextureInfo,
    Vector2,
)
from ndf_mi.capture.synthesise.layers import Picture
from ndf_mi.colour import srgb_to_linear
from ndf_mi.json_input import validated

_WRAP = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
#: Attributes JOINTS_n and WEIGHTS_n that are read; each has four joints of a vertex.
_SETS = 4


@dataclass(frozen=True)
class Part:
    """One primitive: N vertices, F triangles, K nodes that move it.

    Attributes:
        name: of its mesh.
        material: a key of ``lighting.MATERIALS``.
        rest: (N, 3) in the mesh's own space.
        faces: (F, 3).
        same: (N,) one number for all vertices that are one point of a smooth surface, split at texture seams.
        uv: (N, 2), v downwards.
        picture: its base colour, linear, or None.
        colour: (N, 3) linear base colour without a picture.
        nodes: (K,) indices.
        inverse: (K, 4, 4) from the mesh's space to each node's at rest.
        weights: (N, K), rows that sum to 1.
    """

    name: str
    material: str
    rest: np.ndarray
    faces: np.ndarray
    same: np.ndarray
    uv: np.ndarray
    picture: Picture | None
    colour: np.ndarray
    nodes: np.ndarray
    inverse: np.ndarray
    weights: csr_matrix

    def pose(self, world: np.ndarray) -> np.ndarray:
        """(T, N, 3) vertices for (T, nodes, 4, 4) transforms to world space."""
        moves = (world[:, self.nodes] @ self.inverse)[:, :, :3]
        blended = np.stack([(self.weights @ move.reshape(len(self.nodes), 12)).reshape(-1, 3, 4)
                            for move in moves])
        return np.einsum("tnij,nj->tni", blended[..., :3], self.rest) + blended[..., 3]


class _Transform(Struct):
    """KHR_texture_transform."""

    offset: Vector2 = (0.0, 0.0)
    rotation: Finite = 0.0
    scale: Vector2 = (1.0, 1.0)
    texCoord: Index | None = None


def read_parts(buffers: Buffers, nodes: Nodes, notes: list[str]) -> list[Part]:
    """The visible surfaces: meshes with a skin, and meshes that hang from a joint of a skin.

    Args:
        notes: gets a sentence about whatever is left out.

    Raises:
        InputError: the file is wrong, or has no mesh with a skin.
    """
    document = buffers.document
    gltf = document.gltf
    shown = _shown(document, nodes)
    joints = {joint for skin in gltf.skins for joint in skin.joints}
    if not any(gltf.nodes[i].mesh is not None and gltf.nodes[i].skin is not None for i in shown):
        raise document.error("nodes", "no mesh with a skin", "a rigged character")
    parts, still = [], []
    for i in shown:
        node = gltf.nodes[i]
        if node.mesh is None:
            continue
        mesh = document.item(gltf.meshes, node.mesh, "meshes", f"nodes[{i}]")
        if node.skin is None and not joints.intersection(_ancestors(nodes, i)):
            still.append(node.name or mesh.name or f"nodes[{i}]")
            continue
        for k, primitive in enumerate(mesh.primitives):
            where = f"meshes[{node.mesh}].primitives[{k}]"
            if primitive.mode in (0, 1, 2, 3):
                notes.append(f"Points and lines of {mesh.name or where} are left out.")
                continue
            part = _read_part(buffers, primitive, where, mesh.name or where, i, notes)
            parts.append(part)
    if still:
        notes.append(f"Left out, since no joint moves them: {', '.join(still[:8])}.")
    if not parts:
        raise document.error("meshes", "no triangles", "a rigged character")
    return parts


def _shown(document: Document, nodes: Nodes) -> list[int]:
    """The nodes of the default scene, or all if there is none."""
    gltf = document.gltf
    if not gltf.scenes:
        return list(range(len(nodes)))
    scene = document.item(gltf.scenes, gltf.scene or 0, "scenes", "scene")
    inside = set()
    for root in scene.nodes:
        document.item(gltf.nodes, root, "nodes", "scenes")
        inside.add(root)
    for i in nodes.order:
        if nodes.parents[i] in inside:
            inside.add(i)
    return sorted(inside)


def _ancestors(nodes: Nodes, index: int) -> Iterator[int]:
    while index >= 0:
        yield index
        index = int(nodes.parents[index])


def _read_part(buffers: Buffers, primitive: Primitive, where: str, name: str, node: int,
               notes: list[str]) -> Part:
    document = buffers.document
    attributes = primitive.attributes
    if "KHR_draco_mesh_compression" in primitive.extensions and "POSITION" not in attributes:
        raise document.error(where, "Draco compression", "geometry without it")
    if "POSITION" not in attributes:
        raise document.error(where, "no POSITION", "vertices")
    rest = buffers.numbers(attributes["POSITION"], ("VEC3",), f"{where}.POSITION")
    faces = _faces(buffers, primitive, len(rest), where)
    if primitive.targets:
        notes.append(f"Morph targets of {name} are left out.")
    normals = None
    if "NORMAL" in attributes:
        normals = _sized(buffers, primitive, "NORMAL", ("VEC3",), len(rest), where)
    points = rest if normals is None else np.concatenate([rest, np.round(normals, 2)], axis=1)
    same = np.unique(points, axis=0, return_inverse=True)[1].ravel()
    material = Material()
    if primitive.material is not None:
        material = document.item(document.gltf.materials, primitive.material, "materials", where)
    pbr = material.pbrMetallicRoughness
    uv, picture = np.zeros((len(rest), 2)), None
    if pbr.baseColorTexture is not None:
        picture, uv = _picture(buffers, primitive, material, pbr.baseColorTexture, len(rest), where)
    colour = np.tile(np.array(pbr.baseColorFactor[:3]), (len(rest), 1))
    if "COLOR_0" in attributes:
        tint = _sized(buffers, primitive, "COLOR_0", ("VEC3", "VEC4"), len(rest), where)[:, :3]
        if picture is None:
            colour = colour * tint
        elif tint.min() < 0.99:
            notes.append(f"Vertex colours of {name} are left out, since it has a texture.")
    index = document.gltf.nodes[node].skin
    if index is None:
        moved, inverse = np.array([node]), np.eye(4)[None]
        weights = csr_matrix(np.ones((len(rest), 1)))
    else:
        skin = document.item(document.gltf.skins, index, "skins", f"nodes[{node}]")
        moved, inverse = _joints(buffers, skin, f"skins[{index}]")
        weights = _weights(buffers, primitive, len(rest), len(moved), where)
    kind = "cloth" if pbr.roughnessFactor > 0.75 else "skin" if pbr.roughnessFactor > 0.4 else "glossy"
    return Part(name, kind, rest, faces, same, uv, picture, np.clip(colour, 0, 1), moved, inverse, weights)


def _faces(buffers: Buffers, primitive: Primitive, count: int, where: str) -> np.ndarray:
    """(F, 3) indices of triangles, strips or fans, without those of which two corners are the same."""
    if primitive.indices is None:
        corners = np.arange(count)
    else:
        corners = buffers.integers(primitive.indices, ("SCALAR",), count, f"{where}.indices")[:, 0]
    if primitive.mode == 4 and len(corners) % 3 == 0:
        faces = corners.reshape(-1, 3)
    elif primitive.mode == 5 and len(corners) >= 3:
        faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
        faces[1::2] = faces[1::2, ::-1]
    elif primitive.mode == 6 and len(corners) >= 3:
        faces = np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)
    else:
        raise buffers.document.error(where, f"mode {primitive.mode} with {len(corners)} indices", "triangles")
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    if not whole.any():
        raise buffers.document.error(where, "no triangle of three corners", "triangles")
    return faces[whole]


def _sized(buffers: Buffers, primitive: Primitive, key: str, kinds: tuple[str, ...], count: int,
           where: str) -> np.ndarray:
    """An attribute with one row for each of ``count`` vertices."""
    values = buffers.numbers(primitive.attributes[key], kinds, f"{where}.{key}")
    if len(values) != count:
        raise buffers.document.error(f"{where}.{key}", f"{len(values)} values",
                                     f"{count}, one for each vertex")
    return values


def _joints(buffers: Buffers, skin: Skin, where: str) -> tuple[np.ndarray, np.ndarray]:
    """(K,) nodes and (K, 4, 4) inverse bind matrices of a skin."""
    document = buffers.document
    for joint in skin.joints:
        document.item(document.gltf.nodes, joint, "nodes", f"{where}.joints")
    inverse = np.tile(np.eye(4), (len(skin.joints), 1, 1))
    if skin.inverseBindMatrices is not None:
        found = buffers.numbers(skin.inverseBindMatrices, ("MAT4",), f"{where}.inverseBindMatrices")
        if len(found) < len(inverse):
            raise document.error(where, f"{len(found)} inverse bind matrices", f"{len(inverse)}")
        inverse = found[: len(inverse)].reshape(-1, 4, 4).swapaxes(1, 2)
    if (np.abs(np.linalg.det(inverse[:, :3, :3])) < 1e-15).any():
        raise document.error(where, "an inverse bind matrix that cannot be inverted", "invertible matrices")
    return np.array(skin.joints), inverse


def _weights(buffers: Buffers, primitive: Primitive, count: int, joints: int, where: str) -> csr_matrix:
    """(N, joints) skinning weights; rows are normalised to the sum of 1."""
    rows, columns, values = [], [], []
    for k in range(_SETS):
        names = f"JOINTS_{k}", f"WEIGHTS_{k}"
        if not all(name in primitive.attributes for name in names):
            break
        owners = buffers.integers(primitive.attributes[names[0]], ("VEC4",), joints, f"{where}.{names[0]}")
        shares = _sized(buffers, primitive, names[1], ("VEC4",), count, where)
        if len(owners) != count or shares.min() < 0:
            raise buffers.document.error(f"{where}.{names[1]}",
                                         f"{len(owners)} rows and the least weight {shares.min():g}",
                                         f"{count} rows of weights of 0 or more")
        rows.append(np.repeat(np.arange(count), 4))
        columns.append(owners.ravel())
        values.append(shares.ravel())
    if not rows:
        raise buffers.document.error(where, "no JOINTS_0 and WEIGHTS_0", "skinning weights")
    weights = csr_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))),
                         shape=(count, joints))
    total = np.asarray(weights.sum(axis=1)).ravel()
    if total.min() < 1e-6:
        raise buffers.document.error(where, f"vertex {total.argmin()} without weights", "weights above 0")
    return csr_matrix(weights.multiply(1 / total[:, None]))


def _picture(buffers: Buffers, primitive: Primitive, material: Material, info: TextureInfo, count: int,
             where: str) -> tuple[Picture, np.ndarray]:
    """The base colour of a material as a picture, and (N, 2) places in it, v downwards."""
    document = buffers.document
    texture = document.item(document.gltf.textures, info.index, "textures", where)
    webp = texture.extensions.get("EXT_texture_webp")
    source = webp.get("source", texture.source) if isinstance(webp, dict) else texture.source
    if not isinstance(source, int) or isinstance(source, bool) or source < 0:
        raise document.error(f"textures[{info.index}]", "no image", "PNG, JPEG or WebP")
    rgba = buffers.image(source)
    transform = info.extensions.get("KHR_texture_transform", {})
    place = validated(transform, _Transform, f"{document.path}: {where}, KHR_texture_transform")
    key = f"TEXCOORD_{info.texCoord if place.texCoord is None else place.texCoord}"
    if key not in primitive.attributes:
        raise document.error(where, f"no {key}", "texture coordinates")
    uv = _sized(buffers, primitive, key, ("VEC2",), count, where)
    cos, sin = np.cos(place.rotation), np.sin(place.rotation)
    uv = uv * place.scale @ np.array([[cos, -sin], [sin, cos]]) + place.offset
    wrap = "repeat"
    if texture.sampler is not None:
        sampler = document.item(document.gltf.samplers, texture.sampler, "samplers",
                                f"textures[{info.index}]")
        wrap = _WRAP.get(sampler.wrapS, "repeat")
    factor = np.array(material.pbrMetallicRoughness.baseColorFactor)
    colour = np.asarray(srgb_to_linear(rgba[..., :3] / 255)) * factor[:3]
    opaque = None
    cutoff = {"MASK": material.alphaCutoff, "BLEND": 0.5}.get(material.alphaMode)
    if cutoff is not None and (alpha := rgba[..., 3] / 255 * factor[3] >= cutoff).min() == 0:
        opaque = alpha.astype(np.float32)
    picture = Picture(np.clip(colour, 0, 1).astype(np.float32), wrap, opaque)
    return picture, uv
