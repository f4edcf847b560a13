"""The arrays and images of a glTF file: accessors, sparse ones too, meshopt compression, and URIs."""

from __future__ import annotations

import base64
import binascii
import functools
import io
import warnings
from typing import Any
from urllib.parse import unquote

import numpy as np
import PIL.Image
from msgspec import Struct

from ndf_mi.capture.synthesise.character.document import Count, Document, Index, View
from ndf_mi.errors import InputError
from ndf_mi.json_input import validated
from ndf_mi.optional import require

_COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32,
               5126: np.float32}
_SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_COMPRESSION = ("EXT_meshopt_compression", "KHR_meshopt_compression")
#: Bytes of the largest array that a file may ask for.
_MOST = 2**29


class Compressed(Struct):
    """EXT_meshopt_compression of a buffer view."""

    buffer: Index
    byteLength: Count
    byteStride: Count
    count: Count
    mode: str
    byteOffset: Index = 0
    filter: str = "NONE"


class Buffers:
    """Reads the arrays and images of a document.

    External files must lie in the folder of the document; nothing is read from elsewhere. All methods raise
    InputError where the file is wrong.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        # Caches of this object, not of the class.
        self._buffer = functools.cache(self._read_buffer)
        self._view = functools.cache(self._read_view)

    def numbers(self, index: int, kinds: tuple[str, ...], where: str) -> np.ndarray:
        """(count, components) float64 of an accessor of one of the types ``kinds``, all finite; normalised
        integers become numbers in [0, 1] or [-1, 1]."""
        raw, normalised = self._elements(index, kinds, where)
        values = raw.astype(np.float64)
        if normalised and raw.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(raw.dtype).max, -1)
        if not np.isfinite(values).all():
            raise self.document.error(where, "numbers that are not finite", "finite numbers")
        return values

    def integers(self, index: int, kinds: tuple[str, ...], below: int, where: str) -> np.ndarray:
        """(count, components) int64 of an accessor, from 0 to ``below`` - 1."""
        raw, _ = self._elements(index, kinds, where)
        if raw.dtype.kind not in "iu":
            raise self.document.error(where, "numbers with fractions", "whole numbers")
        values = raw.astype(np.int64)
        if values.min() < 0 or values.max() >= below:
            raise self.document.error(where, f"indices from {values.min()} to {values.max()}",
                                      f"indices from 0 to {below - 1}")
        return values

    def image(self, index: int) -> np.ndarray:
        """(h, w, 4) uint8 RGBA of an image."""
        where = f"images[{index}]"
        image = self.document.item(self.document.gltf.images, index, "images", "a texture")
        if image.uri is not None:
            data = self._uri(image.uri, where)
        elif image.bufferView is not None:
            data = self._view(image.bufferView)
        else:
            raise self.document.error(where, "neither uri nor bufferView", "one of them")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", PIL.Image.DecompressionBombWarning)
                with PIL.Image.open(io.BytesIO(data)) as opened:
                    return np.asarray(opened.convert("RGBA"))
        except (OSError, ValueError, SyntaxError, PIL.Image.DecompressionBombError,
                PIL.Image.DecompressionBombWarning) as error:
            raise self.document.error(where, f"an image that cannot be read ({error})",
                                      "PNG, JPEG or WebP") from None

    def _elements(self, index: int, kinds: tuple[str, ...], where: str) -> tuple[np.ndarray, bool]:
        accessor = self.document.item(self.document.gltf.accessors, index, "accessors", where)
        where = f"{where}: accessors[{index}]"
        if accessor.type not in kinds or accessor.componentType not in _COMPONENTS:
            raise self.document.error(where, f"type {accessor.type} of {accessor.componentType}",
                                      f"{' or '.join(kinds)} of one of {', '.join(map(str, _COMPONENTS))}")
        kind, size = np.dtype(_COMPONENTS[accessor.componentType]), _SIZES[accessor.type]
        if accessor.count * size * kind.itemsize > _MOST:
            raise self.document.error(where, f"{accessor.count:,} elements", f"at most {_MOST >> 20} MiB")
        if accessor.bufferView is None:
            values = np.zeros((accessor.count, size), kind)
        else:
            values = self._strided(accessor.bufferView, accessor.byteOffset, accessor.count, kind, size,
                                   where)
        if accessor.sparse is not None:
            sparse = accessor.sparse
            if sparse.indices.componentType not in (5121, 5123, 5125):
                raise self.document.error(where, f"sparse indices of type {sparse.indices.componentType}",
                                          "5121, 5123 or 5125")
            places = self._strided(sparse.indices.bufferView, sparse.indices.byteOffset, sparse.count,
                                   np.dtype(_COMPONENTS[sparse.indices.componentType]), 1, where)[:, 0]
            if places.max() >= accessor.count:
                raise self.document.error(where, f"the sparse index {places.max()}",
                                          f"indices below {accessor.count}")
            values = values.copy()
            values[places] = self._strided(sparse.values.bufferView, sparse.values.byteOffset, sparse.count,
                                           kind, size, where)
        return values, accessor.normalized

    def _strided(self, view: int, offset: int, count: int, kind: np.dtype, size: int,
                 where: str) -> np.ndarray:
        """(count, size) elements of a buffer view."""
        data = self._view(view)
        element = size * kind.itemsize
        stride = self.document.gltf.bufferViews[view].byteStride or element
        end = offset + stride * (count - 1) + element
        if stride < element or end > len(data):
            raise self.document.error(where, f"bufferViews[{view}] of {len(data):,} bytes",
                                      f"at least {end:,} bytes, {stride} a step")
        rows = np.lib.stride_tricks.as_strided(
            np.frombuffer(data, np.uint8, offset=offset), (count, element), (stride, 1))
        return np.ascontiguousarray(rows).view(kind.newbyteorder("<"))

    def _read_view(self, index: int) -> bytes:
        view = self.document.item(self.document.gltf.bufferViews, index, "bufferViews", "an accessor")
        where = f"bufferViews[{index}]"
        for name in _COMPRESSION:
            if name in view.extensions:
                packed = validated(view.extensions[name], Compressed,
                                   f"{self.document.path}: {where}.extensions.{name}")
                return self._unpacked(packed, view, where)
        return self._slice(view.buffer, view.byteOffset, view.byteLength, where)

    def _slice(self, buffer: int, offset: int, length: int, where: str) -> bytes:
        data = self._buffer(buffer)
        if offset + length > len(data):
            raise self.document.error(where, f"bytes {offset:,} to {offset + length:,} of a buffer of "
                                             f"{len(data):,} bytes", "a place within the buffer")
        return data[offset : offset + length]

    def _unpacked(self, packed: Compressed, view: View, where: str) -> bytes:
        """The bytes of a view that is compressed by meshopt."""
        if packed.count * packed.byteStride > _MOST or packed.count * packed.byteStride != view.byteLength:
            raise self.document.error(where, f"{packed.count:,} elements of {packed.byteStride} bytes",
                                      f"{view.byteLength:,} bytes, at most {_MOST >> 20} MiB")
        meshopt: Any = require("meshoptimizer", "character")
        data = self._slice(packed.buffer, packed.byteOffset, packed.byteLength, where)
        count, stride = packed.count, packed.byteStride
        # The decoders trust these numbers.
        filters = {"NONE": (None, stride % 4 == 0),
                   "OCTAHEDRAL": (meshopt.decode_filter_oct, stride in (4, 8)),
                   "QUATERNION": (meshopt.decode_filter_quat, stride == 8),
                   "EXPONENTIAL": (meshopt.decode_filter_exp, stride % 4 == 0)}
        decode, valid = filters.get(packed.filter, (None, False))
        if packed.mode != "ATTRIBUTES":
            valid = packed.mode in ("TRIANGLES", "INDICES") and stride in (2, 4)
            valid = valid and (packed.mode == "INDICES" or count % 3 == 0)
        if not valid or stride > 256:
            raise self.document.error(where, f"mode {packed.mode} and filter {packed.filter} of {count:,} "
                                             f"elements of {stride} bytes", "what meshopt can write")
        try:
            if packed.mode == "ATTRIBUTES":
                out = meshopt.decode_vertex_buffer(count, stride, data)
                return np.ascontiguousarray(out if decode is None else decode(out, count, stride)).tobytes()
            unpack = (meshopt.decode_index_buffer if packed.mode == "TRIANGLES"
                      else meshopt.decode_index_sequence)
            return unpack(count, 4, data).astype(np.uint16 if stride == 2 else np.uint32).tobytes()
        except (RuntimeError, ValueError) as error:
            raise self.document.error(where, f"compressed data that cannot be read ({error})",
                                      "data compressed by meshopt") from None

    def _read_buffer(self, index: int) -> bytes:
        buffer = self.document.item(self.document.gltf.buffers, index, "buffers", "a buffer view")
        where = f"buffers[{index}]"
        if buffer.uri is not None:
            data = self._uri(buffer.uri, where)
        elif index == 0 and self.document.binary is not None:
            data = self.document.binary
        else:
            raise self.document.error(where, "no data", "a uri, or the binary chunk of a .glb file")
        if len(data) < buffer.byteLength:
            raise self.document.error(where, f"{len(data):,} bytes", f"{buffer.byteLength:,} bytes")
        return data

    def _uri(self, uri: str, where: str) -> bytes:
        """The bytes of a data URI, or of a file in the document's folder."""
        if uri.startswith("data:"):
            _, _, text = uri.partition(";base64,")
            try:
                return base64.b64decode(text, validate=True)
            except binascii.Error:
                raise self.document.error(where, "a data URI that cannot be read", "base64") from None
        folder = self.document.path.parent.resolve()
        name = unquote(uri)
        try:
            file = (folder / name).resolve()
            if "://" in uri or not file.is_relative_to(folder):
                raise self.document.error(where, repr(uri[:60]), "a file in the folder of the character")
            return file.read_bytes()
        except (OSError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise self.document.error(where, f"the file {name[:60]!r}, which cannot be read",
                                      "a file next to the character") from None
