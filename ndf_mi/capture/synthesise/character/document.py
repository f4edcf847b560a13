"""The JSON of a glTF 2.0 file, checked: what a skinned, textured and animated character needs of it."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from msgspec import Meta, Struct, field

from ndf_mi.errors import InputError
from ndf_mi.json_input import load_json, validated

T = TypeVar("T")

Index = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Count = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Finite = Annotated[float, Meta(ge=-1e30, le=1e30)]
Vector2 = tuple[Finite, Finite]
Vector3 = tuple[Finite, Finite, Finite]
Vector4 = tuple[Finite, Finite, Finite, Finite]

#: Extensions that a file may require.
EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_mesh_quantization",
              "KHR_texture_transform", "EXT_texture_webp")
_EXPECTED = "a glTF 2.0 file (.glb or .gltf)"
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


class Asset(Struct):
    version: str


class Buffer(Struct):
    byteLength: Count
    uri: str | None = None


class View(Struct):
    byteLength: Count
    buffer: Index = 0
    byteOffset: Index = 0
    byteStride: Annotated[int, Meta(ge=1, le=256)] | None = None
    extensions: dict[str, Any] = {}


class SparseIndices(Struct):
    bufferView: Index
    componentType: int
    byteOffset: Index = 0


class SparseValues(Struct):
    bufferView: Index
    byteOffset: Index = 0


class Sparse(Struct):
    count: Count
    indices: SparseIndices
    values: SparseValues


class Accessor(Struct):
    componentType: int
    count: Count
    type: str
    bufferView: Index | None = None
    byteOffset: Index = 0
    normalized: bool = False
    sparse: Sparse | None = None


class Image(Struct):
    uri: str | None = None
    bufferView: Index | None = None


class Sampler(Struct):
    wrapS: int = 10497
    wrapT: int = 10497


class Texture(Struct):
    source: Index | None = None
    sampler: Index | None = None
    extensions: dict[str, Any] = {}


class TextureInfo(Struct):
    index: Index
    texCoord: Index = 0
    extensions: dict[str, Any] = {}


class PBR(Struct):
    baseColorFactor: Vector4 = (1.0, 1.0, 1.0, 1.0)
    baseColorTexture: TextureInfo | None = None
    roughnessFactor: Finite = 1.0


class Material(Struct):
    name: str = ""
    pbrMetallicRoughness: PBR = field(default_factory=PBR)
    alphaMode: str = "OPAQUE"
    alphaCutoff: Finite = 0.5


class Primitive(Struct):
    attributes: dict[str, Index]
    indices: Index | None = None
    material: Index | None = None
    mode: int = 4
    targets: list[Any] = []
    extensions: dict[str, Any] = {}


class Mesh(Struct):
    primitives: Annotated[list[Primitive], Meta(min_length=1)]
    name: str = ""


class Skin(Struct):
    joints: Annotated[list[Index], Meta(min_length=1)]
    inverseBindMatrices: Index | None = None


class Node(Struct):
    name: str = ""
    children: list[Index] = []
    mesh: Index | None = None
    skin: Index | None = None
    matrix: Annotated[list[Finite], Meta(min_length=16, max_length=16)] | None = None
    translation: Vector3 = (0.0, 0.0, 0.0)
    rotation: Vector4 = (0.0, 0.0, 0.0, 1.0)
    scale: Vector3 = (1.0, 1.0, 1.0)


class Scene(Struct):
    nodes: list[Index] = []


class Target(Struct):
    path: str
    node: Index | None = None


class Channel(Struct):
    sampler: Index
    target: Target


class AnimationSampler(Struct):
    input: Index
    output: Index
    interpolation: str = "LINEAR"


class Clip(Struct):
    channels: list[Channel]
    samplers: list[AnimationSampler]
    name: str = ""


class Gltf(Struct):
    """The document; names are those of the glTF 2.0 specification."""

    asset: Asset
    extensionsRequired: list[str] = []
    scene: Index | None = None
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    skins: list[Skin] = []
    animations: list[Clip] = []
    materials: list[Material] = []
    textures: list[Texture] = []
    samplers: list[Sampler] = []
    images: list[Image] = []
    accessors: list[Accessor] = []
    bufferViews: list[View] = []
    buffers: list[Buffer] = []


@dataclass(frozen=True)
class Document:
    """A parsed file: ``path``, its JSON, and the binary chunk of a ``.glb`` or None."""

    path: Path
    gltf: Gltf
    binary: bytes | None

    def item(self, items: Sequence[T], index: int, key: str, where: str) -> T:
        """``items[index]``; InputError if ``where`` refers to one of ``key`` that does not exist."""
        if index < len(items):
            return items[index]
        raise InputError(f"{self.path}: {where}", f"{key}[{index}]", f"one of {len(items)} {key}")

    def error(self, where: str, found: str, expected: str, repair: str = "") -> InputError:
        """An InputError at ``where`` in this file."""
        return InputError(f"{self.path}: {where}", found, expected, repair)


def read_document(path: Path) -> Document:
    """Parses a ``.glb`` or ``.gltf`` file.

    Raises:
        InputError: there is no such file; it is no glTF 2.0, damaged, or requires an unknown extension, such
            as Draco compression.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream:
            start = stream.read(4)
            data = start + stream.read() if start == b"glTF" else b""
    except FileNotFoundError:
        raise InputError(path, "no such file", _EXPECTED) from None
    except OSError as error:
        raise InputError(path, f"a file that cannot be read ({error.strerror})", _EXPECTED) from None
    value, binary = _chunks(path, data) if data else (load_json(path, _EXPECTED), None)
    gltf = validated(value, Gltf, str(path))
    if gltf.asset.version.partition(".")[0] != "2":
        raise InputError(f"{path}: asset.version", gltf.asset.version, "2.0")
    unknown = [name for name in gltf.extensionsRequired if name not in EXTENSIONS]
    if unknown:
        raise InputError(f"{path}: extensionsRequired", ", ".join(unknown),
                         f"no others than {', '.join(EXTENSIONS)}",
                         "Export the character without these extensions, for example without compression.")
    return Document(path, gltf, binary)


def _chunks(path: Path, data: bytes) -> tuple[Any, bytes | None]:
    """The JSON value and the binary chunk of a GLB container."""
    if len(data) < 20:
        raise InputError(path, f"{len(data)} bytes", "a whole .glb file")
    version, length, size, kind = struct.unpack_from("<4I", data, 4)
    if version != 2:
        raise InputError(path, f"version {version} of the GLB container", "version 2")
    if kind != _JSON or length > len(data) or 20 + size > length:
        raise InputError(path, f"a GLB container of {length:,} bytes in a file of {len(data):,} bytes",
                         "a whole .glb file that starts with its JSON")
    try:
        value = json.loads(data[20:20 + size])
    except (ValueError, RecursionError):
        raise InputError(path, "a JSON chunk that cannot be read", _EXPECTED) from None
    start = 20 + size
    if start + 8 > length:
        return value, None
    size, kind = struct.unpack_from("<2I", data, start)
    if start + 8 + size > length:
        raise InputError(path, f"a binary chunk of {size:,} bytes that ends after the file",
                         "a whole .glb file")
    return value, data[start + 8 : start + 8 + size] if kind == _BINARY else None
