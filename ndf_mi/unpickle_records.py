"""What the names in a pickle stand for: inert records, from which arrays are built later.

A pickle can call what it names with any arguments, and set any state on the result. NumPy's and SciPy's own
functions trust both: with a crafted state, an array reads outside its memory. Here every name is a class
whose instances only store what they are given. `Build` then makes arrays from checked bytes, shapes and
indices.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import sparse

MOST_ENTRIES = 2**23
"""Entries, zeros included, of the largest sparse matrix: ten times those of SMPL-X's joint regressor."""

_DTYPE = re.compile(r"[<>=|]?(?:b1|[iu][1248]|f[248]|c(?:8|16)|[SU]\d{1,6}|O[48]?|\?)")
_MOST_NESTED = 100


class Malformed(ValueError):
    """The records of a pickle do not make arrays; the message completes "a pickle with …"."""


class Record:
    """Stores the arguments it is called with, the state that is set on it and the items that are put into it.

    A pickle cannot alter the class: a state set on it arrives at `__setstate__` without an instance.
    """

    __slots__ = ("arguments", "items", "state")

    arguments: tuple[Any, ...]
    state: Any
    items: dict[Any, Any]

    def __new__(cls, *arguments: Any) -> Record:  # not __init__, which some protocols do not call
        record = super().__new__(cls)
        record.arguments, record.state, record.items = arguments, None, {}
        return record

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def make(self, build: Build) -> Any:
        raise NotImplementedError


def _record(make: Callable[[Record, Build], Any]) -> type[Record]:
    """A kind of record whose value a function makes."""
    return type(make.__name__, (Record,), {"__slots__": (), "make": make})


class Build:
    """Builds the values of a pickle: records become what they stand for, in lists, tuples and dicts.

    A shared value is built once. What all values would take if none was shared must be less than 1 MiB and
    8 bytes for each byte of the file, so that a short file cannot stand for more than can be handled.

    Args:
        size: of the file in bytes.
    """

    def __init__(self, size: int) -> None:
        self._most = 8 * size + 2**20
        self._bytes = 0
        self._done: dict[int, tuple[Any, int]] = {}
        self._kept: list[Any] = []  # so that no id is used twice
        self._depth = 0

    def __call__(self, value: Any) -> Any:
        """The value that `value` stands for.

        Raises:
            Malformed: a record that makes no array, a value that contains itself, or values that take too
                much.
        """
        if not isinstance(value, list | tuple | dict | Record):
            if isinstance(value, type):
                raise Malformed("a class in place of a value")
            self.spend(8)
            return value
        key = id(value)
        if key in self._done:
            result, taken = self._done[key]
            if result is self:
                raise Malformed("a value that contains itself")
            self.spend(taken)
            return result
        if self._depth == _MOST_NESTED:
            raise Malformed(f"values nested more than {_MOST_NESTED} deep")
        self._done[key] = self, 0  # being built
        self._kept.append(value)
        self._depth += 1
        before = self._bytes
        self.spend(8)
        if isinstance(value, dict):
            result = {self(key): self(item) for key, item in value.items()}
        elif isinstance(value, list):
            result = [self(item) for item in value]
        elif isinstance(value, tuple):
            result = tuple(self(item) for item in value)
        else:
            result = value.make(self)
        self._depth -= 1
        self._done[key] = result, self._bytes - before
        return result

    def spend(self, count: int) -> None:
        """Counts bytes that a value takes."""
        self._bytes += count
        if self._bytes > self._most:
            raise Malformed("values that are larger than the file can hold")


@_record
def dtype(record: Record, build: Build) -> np.dtype[Any]:
    """``numpy.dtype``: the kind's name, then as state (version, byte order, …)."""
    text = _text(record.arguments[0] if record.arguments else None)
    if not isinstance(text, str) or not _DTYPE.fullmatch(text):
        raise Malformed("an array of a type that is not of numbers, strings or objects")
    found = np.dtype("O" if text.lstrip("<>=|").startswith("O") else text)
    order = _text(record.state[1]) if isinstance(record.state, tuple) and len(record.state) > 1 else "="
    return found.newbyteorder(">" if order == ">" else "<") if order in ("<", ">") else found


@_record
def reconstruct(record: Record, build: Build) -> np.ndarray:
    """``numpy.core.multiarray._reconstruct``; state: (version, shape, dtype, Fortran order, data)."""
    if not isinstance(record.state, tuple) or len(record.state) not in (4, 5):
        raise Malformed("an array without contents")
    shape, kind, fortran, data = record.state[-4:]
    return _array(build, data, kind, shape, "F" if fortran else "C")


@_record
def from_buffer(record: Record, build: Build) -> np.ndarray:
    """``numpy.core.numeric._frombuffer``: (data, dtype, shape, order), in pickle's protocol 5."""
    data, kind, shape, order = _arguments(record, 4)
    return _array(build, data, kind, shape, "F" if order == "F" else "C")


@_record
def scalar(record: Record, build: Build) -> Any:
    """``numpy.core.multiarray.scalar``: (dtype, data)."""
    kind, data = _arguments(record, 2)
    return _array(build, data, kind, (), "C")[()]


def _sparse(layout: str) -> type[Record]:
    """A matrix of ``scipy.sparse`` in a layout: its attributes as state."""

    @_record
    def matrix(record: Record, build: Build) -> Any:
        state = _attributes(record.state)
        shape = build(state.get("_shape", state.get("shape")))
        if not isinstance(shape, tuple) or len(shape) != 2:
            raise Malformed("a sparse matrix without a shape")
        shape = tuple(int(n) for n in _whole(np.asarray(shape)))
        if min(shape) < 0 or math.prod(shape) > MOST_ENTRIES:
            raise Malformed(f"a sparse matrix of {shape[0]} × {shape[1]} entries")
        try:
            if layout == "coo":
                coords = build(state["coords"] if "coords" in state else (state["row"], state["col"]))
                rows, columns = (_whole(part) for part in coords)
            else:
                along, starts = _whole(build(state["indices"])), _whole(build(state["indptr"]))
                outer = shape[0] if layout == "csr" else shape[1]
                ends = starts.shape == (outer + 1,) and starts[0] == 0 and starts[-1] == len(along)
                if not ends or (np.diff(starts) < 0).any():
                    raise Malformed("a sparse matrix whose rows or columns don't add up")
                across = np.repeat(np.arange(outer), np.diff(starts))
                rows, columns = (across, along) if layout == "csr" else (along, across)
            data = build(state["data"])
        except (KeyError, TypeError) as error:
            raise Malformed(f"a sparse matrix without {error}") from None
        numbers = isinstance(data, np.ndarray) and data.ndim == 1 and data.dtype.kind in "biuf"
        if not numbers or not len(data) == len(rows) == len(columns):
            raise Malformed("a sparse matrix whose values and indices differ in number")
        for index, size in ((rows, shape[0]), (columns, shape[1])):
            if index.size and (index.min() < 0 or index.max() >= size):
                raise Malformed("a sparse matrix with an index outside its shape")
        return sparse.coo_array((data, (rows, columns)), shape=shape).asformat(layout)

    return matrix


@_record
def chumpy_array(record: Record, build: Build) -> np.ndarray:
    """``chumpy.ch.Ch``: an array, the attribute ``x``. Its other attributes serve its gradients."""
    return _values(build, record.state, "x")


@_record
def chumpy_select(record: Record, build: Build) -> np.ndarray:
    """``chumpy.reordering.Select``: the entries ``idxs`` of ``a``, in ``preferred_shape`` if given."""
    state = _attributes(record.state)
    values = _values(build, state, "a").ravel()
    chosen = _whole(np.asarray(build(state.get("idxs")))).ravel()
    if chosen.size and (chosen.min() < 0 or chosen.max() >= values.size):
        raise Malformed("a selection of entries that an array lacks")
    shape = build(state.get("preferred_shape"))
    shape = (chosen.size,) if shape is None else tuple(int(n) for n in _whole(np.asarray(shape)).ravel())
    if not _is_shape(shape) or math.prod(shape) != chosen.size:
        raise Malformed("a selection of another number of entries than its shape has")
    build.spend(chosen.size * values.itemsize)
    return values[chosen].reshape(shape)


@_record
def encoded(record: Record, build: Build) -> bytes:
    """``_codecs.encode(text, "latin1")`` and ``bytes()``, which is how bytes are written for Python 2."""
    match record.arguments:
        case ():
            return b""
        case (str() as text, "latin1" | "latin-1" | "iso-8859-1"):
            return text.encode("latin1")
    raise Malformed("bytes that are not text in latin1")


@_record
def rebuilt(record: Record, build: Build) -> Any:
    """``copy_reg._reconstructor(class, object, None)``: an object in protocols 0 and 1."""
    kind = record.arguments[0] if record.arguments else None
    if not (isinstance(kind, type) and issubclass(kind, Record) and kind is not rebuilt):
        raise Malformed("an object of no class that is known")
    inner = kind()
    inner.state = record.state
    return build(inner)


@_record
def base_class(record: Record, build: Build) -> None:
    """``object`` or ``numpy.ndarray``, which other names take as an argument."""


@_record
def set_as_list(record: Record, build: Build) -> list[Any]:
    """``set(list)``: found among the attributes of chumpy's arrays."""
    return build(record.arguments[0]) if record.arguments else []


@_record
def ordered_dict(record: Record, build: Build) -> dict[Any, Any]:
    """``collections.OrderedDict``: its items follow, or are a list of pairs in Python 2."""
    pairs = record.arguments[0] if record.arguments else []
    listed = isinstance(pairs, list) and all(isinstance(pair, list | tuple) for pair in pairs)
    if not listed or any(len(pair) != 2 for pair in pairs):
        raise Malformed("a dict that is made from something else than pairs")
    return build({checked_key(key): value for key, value in pairs} | record.items)


_BUILTINS = {"object": base_class, "set": set_as_list, "bytes": encoded}
_NAMES: dict[tuple[str, str], type[Record]] = {
    ("numpy", "dtype"): dtype,
    ("numpy", "ndarray"): base_class,
    ("collections", "OrderedDict"): ordered_dict,
    ("_codecs", "encode"): encoded,
    ("chumpy.ch", "Ch"): chumpy_array,
    ("chumpy", "Ch"): chumpy_array,
    ("chumpy.reordering", "Select"): chumpy_select,
    **{(f"numpy.{core}.multiarray", "_reconstruct"): reconstruct for core in ("core", "_core")},
    **{(f"numpy.{core}.multiarray", "scalar"): scalar for core in ("core", "_core")},
    **{(f"numpy.{core}.numeric", "_frombuffer"): from_buffer for core in ("core", "_core")},
    **{(module, "_reconstructor"): rebuilt for module in ("copy_reg", "copyreg")},
    **{(module, name): kind for module in ("__builtin__", "builtins") for name, kind in _BUILTINS.items()},
    **{(module, f"{layout}_{suffix}"): kind
       for layout in ("csc", "csr", "coo") for kind in (_sparse(layout),) for suffix in ("matrix", "array")
       for module in (f"scipy.sparse.{layout}", f"scipy.sparse._{layout}", "scipy.sparse")},
}  # fmt: skip


def checked_key(key: Any) -> Any:
    """The key of a dict, if hashing it takes no longer than reading it.

    Raises:
        Malformed: the key is neither text, a whole number nor None.
    """
    if key is None or isinstance(key, str | bytes | Record) or (isinstance(key, int) and abs(key) < 2**60):
        return key
    raise Malformed("a dict with a key that is neither text nor a whole number")


def admitted(module: str, name: str) -> type[Record] | None:
    """The kind of record that a name in a pickle stands for; None if the name is not admitted."""
    return _NAMES.get((module, name))


def _array(build: Build, data: Any, kind: Any, shape: Any, order: Any) -> np.ndarray:
    """An array with its own memory from bytes (or latin1 text) or, for objects, from a list."""
    if not isinstance(kind, dtype) or not _is_shape(shape):
        raise Malformed("an array without a shape or a type")
    made, count = kind.make(build), math.prod(shape)
    if made.hasobject:
        if not isinstance(data, list) or len(data) != count:
            raise Malformed("an array of another number of objects than its shape has")
        objects = np.empty(count, dtype=object)
        for i, item in enumerate(data):
            objects[i] = build(item)
        return objects.reshape(shape, order=order)
    data = build(data)
    if isinstance(data, str):
        data = data.encode("latin1")
    if not isinstance(data, bytes | bytearray) or len(data) != count * made.itemsize:
        raise Malformed("an array whose data are of another size than its shape")
    build.spend(len(data))
    array = np.frombuffer(data, dtype=made, count=count).reshape(shape, order=order)
    return array.astype(made.newbyteorder("="), order="C")


def _is_shape(shape: Any) -> bool:
    whole = isinstance(shape, tuple) and len(shape) <= 8
    return whole and all(isinstance(n, int) and not isinstance(n, bool) and 0 <= n < 2**40 for n in shape)


def _arguments(record: Record, count: int) -> tuple[Any, ...]:
    if len(record.arguments) != count:
        raise Malformed("an array without contents")
    return record.arguments


def _attributes(state: Any) -> dict[str, Any]:
    """An object's attributes: a dict, or a pair of that and of those in slots."""
    if isinstance(state, tuple) and len(state) == 2:
        state = {key: value for part in state if isinstance(part, dict) for key, value in part.items()}
    if isinstance(state, dict):
        return state
    raise Malformed("an object without attributes")


def _values(build: Build, state: Any, name: str) -> np.ndarray:
    values = build(_attributes(state).get(name))
    if isinstance(values, np.ndarray) and values.dtype.kind in "biuf":
        return values
    raise Malformed(f"an array of chumpy without its values ({name})")


def _whole(array: Any) -> np.ndarray:
    if isinstance(array, np.ndarray) and array.dtype.kind in "iu":
        return array
    raise Malformed("indices that are not whole numbers")


def _text(value: Any) -> Any:
    return value.decode("ascii", "replace") if isinstance(value, bytes) else value
