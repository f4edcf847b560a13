"""Arrays out of pickles that others wrote, without running anything that a pickle names.

Nothing of numpy, scipy or chumpy is called by the file: the names that it may use stand for inert records of ours, which only
keep what they are given. Once the pickle has been read, arrays are put together from their bytes, sparse matrices from checked
indices, and chumpy's arrays by their values. Any other name ends the reading.
"""

from __future__ import annotations

import io
import os
import pickle
import re
import warnings
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from ndf_mi.errors import InputError
from ndf_mi.unpickle_records import Malformed, admitted, plain

MOST_BYTES = 2**31
"""A file, or a member of an ``.npz``, larger than this is refused: a body model is a hundredth of it."""

_ADMITTED = "arrays of numpy, matrices of scipy.sparse and arrays of chumpy, in lists and dicts"


def load_pickle(path: str | os.PathLike[str]) -> Any:
    """What a pickle holds: numbers, strings, lists, tuples, dicts, numpy arrays and scipy.sparse matrices.

    Python 2's strings are read as latin1; chumpy's arrays (`chumpy.ch.Ch`, `chumpy.reordering.Select`) come as numpy arrays.

    Raises:
        InputError: no such file, a damaged one, or one that names another class or function, which the message names.
    """
    path = Path(path)
    return _unpickle(os.fspath(path), _contents(path, "a pickle"))


def load_npy(path: str | os.PathLike[str]) -> Any:
    """What a ``.npy`` file holds: an array, or the object that was pickled into it (a dict, as a rule), as `load_pickle` gives it.

    Raises:
        InputError: as `load_pickle`; or the file is no ``.npy``.
    """
    path = Path(path)
    return _npy(os.fspath(path), _contents(path, "a .npy file"))


def load_npz(path: str | os.PathLike[str], keys: Sequence[str]) -> dict[str, Any]:
    """Those of the named entries of an ``.npz`` file that are there, pickled ones as `load_npy` gives them.

    Raises:
        InputError: as `load_npy`; or the file is no ``.npz``.
    """
    path = Path(path)
    found: dict[str, Any] = {}
    try:
        with zipfile.ZipFile(io.BytesIO(_contents(path, "an .npz file"))) as archive:
            sizes = {entry.filename: entry.file_size for entry in archive.infolist()}
            for key in keys:
                name = f"{key}.npy"
                if name in sizes:
                    _check_size(f"{path}: {key}", sizes[name])
                    found[key] = _npy(f"{path}: {key}", archive.read(name))
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
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of a header that Python 2 wrote
            _, _, kind = read(stream)
        if not kind.hasobject:
            stream.seek(0)
            return np.lib.format.read_array(stream, allow_pickle=False)
    except Exception as error:  # numpy's reading of a damaged header can end in nearly any exception
        raise InputError(where, f"a damaged or truncated file ({error})", "a .npy file") from None
    value = _unpickle(where, data[stream.tell() :])
    return value.item() if isinstance(value, np.ndarray) and value.shape == () else value


class _Unpickler(pickle.Unpickler):
    """Admits the names in `admitted`; see there for why none of them runs anything."""

    def __init__(self, where: str, data: bytes) -> None:
        super().__init__(io.BytesIO(data), fix_imports=False, encoding="latin1")
        self._where = where

    def find_class(self, module: str, name: str) -> Any:
        found = admitted(module, name)
        if found is None:
            # What a pickle names is shown as it stands only where it is a name.
            shown = f"{module}.{name}" if re.fullmatch(r"[\w.]{1,100}", f"{module}.{name}") else ascii(f"{module}.{name}")[:100]
            repair = "Nothing of it has been run. Where you trust the file, save its arrays with numpy.savez in the program that wrote it."
            raise InputError(self._where, f"a pickle that names {shown}", _ADMITTED, repair)
        return found

    def persistent_load(self, pid: Any) -> NoReturn:
        raise pickle.UnpicklingError("it refers to objects outside the file")


def _unpickle(where: str, data: bytes) -> Any:
    try:
        return plain(_Unpickler(where, data).load())
    except InputError:
        raise
    except Malformed as error:
        raise InputError(where, f"a pickle with {error}", _ADMITTED) from None
    except Exception as error:  # a damaged pickle can end in nearly any exception
        raise InputError(where, f"a damaged or truncated pickle ({type(error).__name__}: {error})", "a whole pickle") from None


