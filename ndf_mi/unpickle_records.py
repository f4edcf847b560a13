"""What the names in a pickle stand for: records that keep what they are given, and the arrays made of them afterwards.

A pickle can call what it names with any arguments, set any state on the result, and on what it names itself. So each name here
is a class whose instances only store, and whose class cannot be altered by a pickle: state set on the class arrives
at `__setstate__` without an instance and fails.
"""

from __future__ import annotations

import math
import re
from collections import OrderedDict
from typing import Any

import numpy as np
from scipy import sparse

_DTYPE = re.compile(r"[<>=|]?(?:b1|[iu][1248]|f[248]|c(?:8|16)|[SU]\d{1,6}|O[48]?|\?)")
_MOST_NESTED = 100


class Malformed(ValueError):
    """The records of a pickle don't make an array; the message completes "a pickle with …"."""


class Record:
    """Keeps the arguments it is made with and the state that is set on it."""

    __slots__ = ("arguments", "state")

    arguments: tuple[Any, ...]
    state: Any

    def __new__(cls, *arguments: Any) -> Record:  # not __init__, which not every protocol calls
        record = super().__new__(cls)
        record.arguments = arguments
        record.state = None
        return record

    def __setstate__(self, state: Any) -> None:
        self.state = state


class DtypeRecord(Record):
    """``numpy.dtype``: the kind's name, then as state (version, byte order, …)."""

    __slots__ = ()

    def dtype(self) -> np.dtype[Any]:
        text = self.arguments[0] if self.arguments else None
        text = text.decode("ascii", "replace") if isinstance(text, bytes) else text
        if not isinstance(text, str) or not _DTYPE.fullmatch(text):
            raise Malformed("an array of a type that is not of numbers, strings or objects")
        dtype = np.dtype("O" if text.lstrip("<>=|").startswith("O") else text)
        order = self.state[1] if isinstance(self.state, tuple) and len(self.state) > 1 else "="
        order = order.decode("ascii", "replace") if isinstance(order, bytes) else order
        if order == ">":
            return dtype.newbyteorder(">")
        return dtype.newbyteorder("<") if order == "<" else dtype


class ArrayRecord(Record):
    """``numpy.core.multiarray._reconstruct``: an empty array, whose state is (version, shape, dtype, Fortran order, data)."""

    __slots__ = ()

    def make(self, walk: _Walk) -> np.ndarray:
        if not isinstance(self.state, tuple) or len(self.state) not in (4, 5):
            raise Malformed("an array without contents")
        shape, kind, fortran, data = self.state[-4:]
        return _array(walk, data, kind, shape, "F" if fortran else "C")


class BufferRecord(Record):
    """``numpy.core.numeric._frombuffer``: (data, dtype, shape, order), an array in pickle's fifth protocol."""

    __slots__ = ()

    def make(self, walk: _Walk) -> np.ndarray:
        if len(self.arguments) != 4:
            raise Malformed("an array without contents")
        data, kind, shape, order = self.arguments
        return _array(walk, data, kind, shape, "F" if order == "F" else "C")


class ScalarRecord(Record):
    """``numpy.core.multiarray.scalar``: (dtype, data)."""

    __slots__ = ()

    def make(self, walk: _Walk) -> Any:
        if len(self.arguments) != 2:
            raise Malformed("a number without a value")
        kind, data = self.arguments
        return _array(walk, data, kind, (), "C")[()]


class SparseRecord(Record):
    """A matrix of ``scipy.sparse``: its attributes as state. `FORMAT` names the layout of the subclass."""

    __slots__ = ()
    FORMAT = ""

    def make(self, walk: _Walk) -> Any:
        state = _attributes(self.state)
        shape = walk(state.get("_shape", state.get("shape")))
        if not isinstance(shape, tuple) or len(shape) != 2:
            raise Malformed("a sparse matrix without a shape")
        shape = tuple(int(n) for n in _whole(np.asarray(shape)))
        try:
            if self.FORMAT == "coo":
                coords = walk(state["coords"]) if "coords" in state else (walk(state["row"]), walk(state["col"]))
                rows, columns = (_whole(part) for part in coords)
            else:
                along, starts = _whole(walk(state["indices"])), _whole(walk(state["indptr"]))
                outer = shape[0] if self.FORMAT == "csr" else shape[1]
                if starts.shape != (outer + 1,) or starts[0] != 0 or starts[-1] != len(along) or (np.diff(starts) < 0).any():
                    raise Malformed("a sparse matrix whose columns or rows don't add up")
                across = np.repeat(np.arange(outer), np.diff(starts))
                rows, columns = (across, along) if self.FORMAT == "csr" else (along, across)
            data = walk(state["data"])
        except (KeyError, TypeError) as error:
            raise Malformed(f"a sparse matrix without {error}") from None
        numbers = isinstance(data, np.ndarray) and data.ndim == 1 and data.dtype.kind in "biuf"
        if not numbers or not len(data) == len(rows) == len(columns):
            raise Malformed("a sparse matrix whose values and indices differ in number")
        for index, size in ((rows, shape[0]), (columns, shape[1])):
            if index.size and (index.min() < 0 or index.max() >= size):
                raise Malformed("a sparse matrix with an index outside its shape")
        return sparse.coo_array((data, (rows, columns)), shape=shape).asformat(self.FORMAT)


class CscRecord(SparseRecord):
    __slots__ = ()
    FORMAT = "csc"


class CsrRecord(SparseRecord):
    __slots__ = ()
    FORMAT = "csr"


class CooRecord(SparseRecord):
    __slots__ = ()
    FORMAT = "coo"


class ChumpyRecord(Record):
    """``chumpy.ch.Ch``: an array, kept as the attribute ``x``; what else it knows is for its gradients."""

    __slots__ = ()

    def make(self, walk: _Walk) -> np.ndarray:
        return _values(walk, self.state, "x")


class SelectRecord(Record):
    """``chumpy.reordering.Select``: the entries ``idxs`` of ``a``, row by row, in ``preferred_shape`` where there is one."""

    __slots__ = ()

    def make(self, walk: _Walk) -> np.ndarray:
        state = _attributes(self.state)
        values = _values(walk, state, "a").ravel()
        chosen = _whole(np.asarray(walk(state.get("idxs")))).ravel()
        if chosen.size and (chosen.min() < 0 or chosen.max() >= values.size):
            raise Malformed("a selection of entries that an array lacks")
        shape = walk(state.get("preferred_shape"))
        if shape is None:
            return values[chosen]
        shape = tuple(int(n) for n in _whole(np.asarray(shape)).ravel())
        if not _is_shape(shape) or math.prod(shape) != chosen.size:
            raise Malformed("a selection of another number of entries than its shape has")
        return values[chosen].reshape(shape)


class EncodeRecord(Record):
    """``_codecs.encode``: (text, "latin1"), which is how bytes are written for Python 2."""

    __slots__ = ()

    def make(self, walk: _Walk) -> bytes:
        match self.arguments:
            case (str() as text, "latin1" | "latin-1" | "iso-8859-1"):
                return text.encode("latin1")
        raise Malformed("bytes that are not in latin1")


class BytesRecord(Record):
    """``bytes()``, which is how empty bytes are written for Python 2."""

    __slots__ = ()

    def make(self, walk: _Walk) -> bytes:
        if self.arguments:
            raise Malformed("bytes that are made from something else")
        return b""


class RebuiltRecord(Record):
    """``copy_reg._reconstructor(class, object, None)``: an object of a class in pickle's first two protocols; its state follows."""

    __slots__ = ()

    def make(self, walk: _Walk) -> Any:
        kind = self.arguments[0] if self.arguments else None
        if not (isinstance(kind, type) and issubclass(kind, Record) and kind is not RebuiltRecord):
            raise Malformed("an object of no class that is known")
        record = kind()
        record.state = self.state
        return walk(record)


class ObjectRecord(Record):
    """``object``: what `RebuiltRecord` names as the base; nothing by itself."""

    __slots__ = ()

    def make(self, walk: _Walk) -> None:
        return None


class SetRecord(Record):
    """``set(list)``: among the attributes of chumpy's arrays; never needed by itself."""

    __slots__ = ()

    def make(self, walk: _Walk) -> list[Any]:
        return walk(self.arguments[0]) if self.arguments else []


_ARRAYS = ("numpy.core.multiarray", "numpy._core.multiarray")
_NAMES: dict[tuple[str, str], type] = {
    ("numpy", "dtype"): DtypeRecord,
    ("numpy", "ndarray"): ObjectRecord,
    ("collections", "OrderedDict"): OrderedDict,
    ("_codecs", "encode"): EncodeRecord,
    ("chumpy.ch", "Ch"): ChumpyRecord,
    ("chumpy", "Ch"): ChumpyRecord,
    ("chumpy.reordering", "Select"): SelectRecord,
    **{(module, "_reconstruct"): ArrayRecord for module in _ARRAYS},
    **{(module, "scalar"): ScalarRecord for module in _ARRAYS},
    **{(module, "_frombuffer"): BufferRecord for module in ("numpy.core.numeric", "numpy._core.numeric")},
    **{(module, "_reconstructor"): RebuiltRecord for module in ("copy_reg", "copyreg")},
    **{
        (module, name): record
        for module in ("__builtin__", "builtins")
        for name, record in (("object", ObjectRecord), ("set", SetRecord), ("bytes", BytesRecord))
    },
    **{
        (module, f"{form}_{kind}"): record
        for form, record in (("csc", CscRecord), ("csr", CsrRecord), ("coo", CooRecord))
        for kind in ("matrix", "array")
        for module in (f"scipy.sparse.{form}", f"scipy.sparse._{form}", "scipy.sparse")
    },
}


def admitted(module: str, name: str) -> type | None:
    """What a pickle's name stands for, or None where it is not one of those admitted."""
    return _NAMES.get((module, name))


def plain(value: Any) -> Any:
    """``value`` with all records in it made into what they stand for.

    Raises:
        Malformed: a record that makes no array, or a value that holds itself.
    """
    return _Walk()(value)


class _Walk:
    """Goes through lists, tuples and dicts once each, however often they are shared."""

    def __init__(self) -> None:
        self._done: dict[int, Any] = {}
        self._kept: list[Any] = []  # ids are those of living objects
        self._depth = 0

    def __call__(self, value: Any) -> Any:
        if not isinstance(value, list | tuple | dict | Record):
            if isinstance(value, type):
                raise Malformed("a class in place of a value")
            return value
        key = id(value)
        if key in self._done:
            if self._done[key] is self:
                raise Malformed("a value that holds itself")
            return self._done[key]
        if self._depth == _MOST_NESTED:
            raise Malformed(f"values nested more than {_MOST_NESTED} deep")
        self._done[key] = self  # being made
        self._kept.append(value)
        self._depth += 1
        result = self._make(value)
        self._depth -= 1
        self._done[key] = result
        return result

    def _make(self, value: Any) -> Any:
        if isinstance(value, dict):
            return {self(key): self(item) for key, item in value.items()}
        if isinstance(value, list):
            return [self(item) for item in value]
        if isinstance(value, tuple):
            return tuple(self(item) for item in value)
        if isinstance(value, DtypeRecord):
            return value.dtype()
        return value.make(self)


def _array(walk: _Walk, data: Any, kind: Any, shape: Any, order: Any) -> np.ndarray:
    """An array of its own memory from bytes (latin1 text, where Python 2 wrote them) or, for objects, from a list."""
    if not isinstance(kind, DtypeRecord) or not _is_shape(shape):
        raise Malformed("an array without a shape or a type")
    dtype, count = kind.dtype(), math.prod(shape)
    if dtype.hasobject:
        if not isinstance(data, list) or len(data) != count:
            raise Malformed("an array of another number of objects than its shape has")
        objects = np.empty(count, dtype=object)
        for i, item in enumerate(data):
            objects[i] = walk(item)
        return objects.reshape(shape, order=order)
    data = walk(data)
    if isinstance(data, str):
        data = data.encode("latin1")
    if not isinstance(data, bytes | bytearray) or len(data) != count * dtype.itemsize:
        raise Malformed(f"an array of {shape} whose data are of another size")
    return np.frombuffer(data, dtype=dtype, count=count).reshape(shape, order=order).astype(dtype.newbyteorder("="), order="C")


def _is_shape(shape: Any) -> bool:
    whole = isinstance(shape, tuple) and len(shape) <= 8
    return whole and all(isinstance(n, int) and not isinstance(n, bool) and 0 <= n < 2**40 for n in shape)


def _attributes(state: Any) -> dict[str, Any]:
    """An object's attributes: a dict, or a pair of that and of those in slots."""
    if isinstance(state, tuple) and len(state) == 2:
        parts = [part for part in state if isinstance(part, dict)]
        state = {key: value for part in parts for key, value in part.items()}
    if not isinstance(state, dict):
        raise Malformed("an object without attributes")
    return state


def _values(walk: _Walk, state: Any, name: str) -> np.ndarray:
    values = walk(_attributes(state).get(name))
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "biuf":
        raise Malformed(f"an array of chumpy without its values ({name})")
    return values


def _whole(array: Any) -> np.ndarray:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iu":
        raise Malformed("indices that are not whole numbers")
    return array
