"""Reads arrays from pickles that others wrote, without running anything that a pickle names.

The names that a pickle may use stand for inert records (`ndf_mi.unpickle_records`), which only store what
they are given. Once the pickle has been read, arrays are built from their bytes, sparse matrices from checked
indices, and chumpy's arrays from their values. Any other name is refused. Time and memory are bounded by the
size of the file, whatever it claims.
"""

from __future__ import annotations

import io
import os
import pickle
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.unpickle_records import Build, Malformed, Record, admitted, checked_key

MOST_BYTES = 2**31
"""The largest file, or member of an ``.npz``, that is read; a body model is a hundredth of it."""

MOST_UNPACKED, MOST_RATIO = 2**26, 100
"""A member of an ``.npz`` that takes more bytes than the first must have been packed to no less than 1 in so
many.
"""

_ADMITTED = "arrays of numpy, matrices of scipy.sparse and arrays of chumpy, in lists and dicts"


def load_pickle(path: str | os.PathLike[str]) -> Any:
    """Reads a pickle: numbers, strings, lists, tuples, dicts, numpy arrays and scipy.sparse matrices.

    Python 2's strings are read as latin1. Arrays of chumpy (`chumpy.ch.Ch`, `chumpy.reordering.Select`)
    become numpy arrays, sets become lists.

    Raises:
        InputError: the file is missing or damaged, stands for more than it can hold, or names another class
            or function.
    """
    path = Path(path)
    return _unpickle(os.fspath(path), _contents(path, "a pickle"))


def load_npy(path: str | os.PathLike[str]) -> Any:
    """Reads a ``.npy`` file: an array, or the pickled object in it, as `load_pickle` returns it.

    Raises:
        InputError: as `load_pickle`; or the file is not a ``.npy`` file.
    """
    path = Path(path)
    return _npy(os.fspath(path), _contents(path, "a .npy file"))


def load_npz(path: str | os.PathLike[str], keys: Sequence[str]) -> dict[str, Any]:
    """Reads those of the named entries of an ``.npz`` file that exist, pickled ones as `load_npy` does.

    Raises:
        InputError: as `load_npy`; or the file is not an ``.npz`` file.
    """
    path = Path(path)
    found: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(_contents(path, "an .npz file"))) as archive:
            entries = {entry.filename: entry for entry in archive.infolist()}
            for key, entry in [(key, entries[f"{key}.npy"]) for key in keys if f"{key}.npy" in entries]:
                where, size, packed = f"{path}: {key}", entry.file_size, entry.compress_size
                _check_size(where, size)
                if size > max(MOST_UNPACKED, MOST_RATIO * packed):
                    raise InputError(where, f"data that unpack to {size // max(packed, 1)} times their size",
                                     f"{MOST_RATIO} times at most")
                found[key] = _npy(where, archive.read(entry))
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError) as error:
        raise InputError(path, f"a damaged or truncated file ({error})", "an .npz file") from None
    return found


def _contents(path: Path, kind: str) -> bytes:
    try:
        _check_size(os.fspath(path), path.stat().st_size)
        return path.read_bytes()
    except FileNotFoundError:
        raise InputError(path, "no such file", kind) from None
    except OSError as error:
        raise InputError(path, f"something that cannot be read ({error.strerror})", kind) from None


def _check_size(where: str, size: int) -> None:
    if size > MOST_BYTES:
        raise InputError(where, f"{size / 2**30:.1f} GiB", f"{MOST_BYTES // 2**30} GiB at most")


def _npy(where: str, data: bytes) -> Any:
    stream = io.BytesIO(data)
    try:
        form = np.lib.format
        first = form.read_magic(stream) == (1, 0)
        read = form.read_array_header_1_0 if first else form.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a header that Python 2 wrote
            _, _, kind = read(stream)
        if not kind.hasobject:
            stream.seek(0)
            return form.read_array(stream, allow_pickle=False)
    except Exception as error:  # numpy's reading of a damaged header can end in nearly any exception
        raise InputError(where, f"a damaged or truncated file ({error})", "a .npy file") from None
    value = _unpickle(where, data[stream.tell() :])
    return value.item() if isinstance(value, np.ndarray) and value.shape == () else value


_Reader: Any = pickle._Unpickler


class _Unpickler(_Reader):
    """Reads a pickle with the names in `admitted`, none of which runs anything.

    It extends the reader written in Python, since the one in C makes room for any number that a file gives to
    a memorised value: eleven bytes can take 4 GiB. Sizes and keys of dicts are checked: the hash of a tuple
    of shared tuples can take years.
    """

    def __init__(self, where: str, data: bytes) -> None:
        super().__init__(io.BytesIO(data), fix_imports=False, encoding="latin1")
        self._where = where
        self._size = len(data)

    def find_class(self, module: str, name: str) -> Any:
        found = admitted(module, name)
        if found is None:
            # Anything else than a name is shown escaped.
            full = f"{module}.{name}"
            shown = full if re.fullmatch(r"[\w.]{1,100}", full) else ascii(full)[:100]
            repair = ("Nothing in it has been run. If you trust the file, load it with the program that "
                      "wrote it, and save its arrays with numpy.savez.")
            raise InputError(self._where, f"a pickle that names {shown}", _ADMITTED, repair)
        return found

    def persistent_load(self, pid: Any) -> NoReturn:
        raise pickle.UnpicklingError("it refers to objects outside the file")

    def load_setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._put([key, value])

    def load_setitems(self) -> None:
        self._put(self.pop_mark())

    def load_dict(self) -> None:
        items = self.pop_mark()
        self.append({})
        self._put(items)

    def load_bytearray8(self) -> None:
        (size,) = struct.unpack("<Q", self.read(8))
        if size > self._size:
            raise pickle.UnpicklingError("it is truncated")
        self.append(bytearray(self.read(size)))

    def _put(self, items: list[Any]) -> None:
        """Puts keys and values, which alternate, into the dict on top of the stack."""
        top = self.stack[-1]
        target = top.items if isinstance(top, Record) else top
        if not isinstance(target, dict):
            raise pickle.UnpicklingError("it puts items into something else than a dict")
        for key, value in zip(items[::2], items[1::2], strict=True):
            target[checked_key(key)] = value

    dispatch = _Reader.dispatch | {
        pickle.SETITEM[0]: load_setitem,
        pickle.SETITEMS[0]: load_setitems,
        pickle.DICT[0]: load_dict,
        pickle.BYTEARRAY8[0]: load_bytearray8,
        # Sets are never needed, and become lists.
        pickle.EMPTY_SET[0]: _Reader.load_empty_list,
        pickle.ADDITEMS[0]: _Reader.load_appends,
        pickle.FROZENSET[0]: _Reader.load_list,
    }


def _unpickle(where: str, data: bytes) -> Any:
    try:
        return Build(len(data))(_Unpickler(where, data).load())
    except InputError:
        raise
    except Malformed as error:
        raise InputError(where, f"a pickle with {error}", _ADMITTED) from None
    except Exception as error:  # a damaged pickle can end in nearly any exception
        found = f"a damaged or truncated pickle ({type(error).__name__}: {error})"
        raise InputError(where, found if len(found) < 300 else f"{found[:300]}…", "a whole pickle") from None
