"""Reading and checking the arrays of ``.npz`` files: every refusal names the file and the key."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi.errors import InputError


def read_npz(
    path: str | os.PathLike[str], required: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """The named arrays of an ``.npz`` file, read without pickle. Keys that are not named are ignored.

    Raises:
        InputError: the file is missing, truncated, no ``.npz``, lacks a required key, or holds Python objects.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "no such file", "an .npz file")
    try:
        loaded = np.load(path, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise InputError(path, "a single array", "an .npz file")
        with loaded as archive:
            for key in required:
                if key not in archive.files:
                    there = ", ".join(archive.files) or "nothing"
                    raise InputError(f"{path}: {key}", f"only {there}", f"an array {key!r}")
            arrays = {}
            for key in (*required, *optional):
                if key in archive.files:
                    arrays[key] = _load(path, archive, key)
            return arrays
    except InputError:
        raise
    except Exception as error:  # numpy's reading of a damaged header can end in nearly any exception
        raise InputError(path, f"a damaged or truncated file ({error})", "an .npz file", "write it again") from error


def _load(path: Path, archive: np.lib.npyio.NpzFile, key: str) -> np.ndarray:
    try:
        return archive[key]
    except ValueError as error:
        if "allow_pickle" in str(error):
            raise InputError(f"{path}: {key}", "Python objects", "a plain array") from error
        raise


def regular(where: str, value: Any) -> np.ndarray:
    """``value``, an array or lists of numbers, as an array.

    Raises:
        InputError: rows of unequal length.
    """
    try:
        return np.asarray(value)
    except ValueError:
        raise InputError(where, "rows of unequal length", "an array of numbers") from None


def floats(where: str, array: np.ndarray, shape: Sequence[int | None]) -> np.ndarray:
    """``array`` as contiguous float32, checked against ``shape`` (None: any length) and for NaN and infinity.

    Raises:
        InputError: with ``where`` in front, saying what was found and expected.
    """
    array = np.asarray(array)
    if array.dtype.kind not in "fiu":
        raise InputError(where, f"type {array.dtype}", "float32")
    check_shape(where, array, shape)
    result = np.ascontiguousarray(array, dtype=np.float32)
    bad = ~np.isfinite(result)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        found = f"{int(bad.sum())} values not finite, the first {array[first]} at {list(first)}"
        raise InputError(where, found, "finite numbers")
    return result


def indices(where: str, array: np.ndarray, shape: Sequence[int | None], low: int, high: int) -> np.ndarray:
    """``array`` as contiguous int32, checked against ``shape`` and the range ``low <= value < high``; see `floats`."""
    array = np.asarray(array)
    if array.dtype.kind not in "iu":
        raise InputError(where, f"type {array.dtype}", "int32")
    check_shape(where, array, shape)
    if array.size and (array.min() < low or array.max() >= high):
        raise InputError(where, f"values from {array.min()} to {array.max()}", f"values from {low} to {high - 1}")
    return np.ascontiguousarray(array, dtype=np.int32)


@contextlib.contextmanager
def located(short: str, path: str | os.PathLike[str]) -> Iterator[None]:
    """Makes an InputError raised inside, whose place begins with ``short``, name ``path`` instead."""
    try:
        yield
    except InputError as error:
        where = os.fspath(path) + error.where.removeprefix(short)
        raise InputError(where, error.found, error.expected, error.repair) from None


def check_shape(where: str, array: np.ndarray, shape: Sequence[int | None]) -> None:
    """Raises InputError unless ``array`` has ``shape``, where None stands for any length."""
    fits = array.ndim == len(shape) and all(n is None or n == m for n, m in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(where, f"shape {array.shape}", f"shape ({wanted}{',' if len(shape) == 1 else ''})")
