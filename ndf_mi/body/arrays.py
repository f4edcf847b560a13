"""Reads and checks the arrays of ``.npz`` files; every error names the file and the key."""

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
    """The named arrays of an ``.npz`` file, read without pickle; other keys are ignored.

    Raises:
        InputError: the file is missing, truncated or not an ``.npz``, lacks a required key, or holds Python
            objects.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "no such file", "an .npz file")
    try:
        loaded = np.load(path, allow_pickle=False)
        if not isinstance(loaded, np.lib.npyio.NpzFile):
            raise InputError(path, "a single array", "an .npz file")
        with loaded as archive:
            for key in (key for key in required if key not in archive.files):
                present = ", ".join(archive.files) or "nothing"
                raise InputError(f"{path}: {key}", f"only {present}", f"an array {key!r}")
            return {key: _load(path, archive, key) for key in (*required, *optional) if key in archive.files}
    except InputError:
        raise
    except Exception as error:  # a damaged header makes numpy raise nearly any exception
        found = f"a damaged or truncated file ({error})"
        raise InputError(path, found, "an .npz file", "Write it again.") from error


def _load(path: Path, archive: np.lib.npyio.NpzFile, key: str) -> np.ndarray:
    try:
        return archive[key]
    except ValueError as error:
        if "allow_pickle" in str(error):
            raise InputError(f"{path}: {key}", "Python objects", "a plain array") from error
        raise


def regular(where: str, value: Any) -> np.ndarray:
    """``value``, an array or nested lists, as an array; InputError if rows have unequal lengths, or a list
    holds something else than numbers."""
    if isinstance(value, list | tuple) and not _numbers(value):
        raise InputError(where, "something else than numbers", "an array of numbers")
    try:
        return np.asarray(value)
    except ValueError:
        raise InputError(where, "rows of unequal length", "an array of numbers") from None


def _numbers(values: Sequence[Any]) -> bool:
    """Whether nested lists hold numbers alone. One long text would make each entry of an array as long."""
    return all(_numbers(value) if isinstance(value, list | tuple) else np.asarray(value).dtype.kind in "biuf"
               for value in values)


def floats(where: str, array: np.ndarray, shape: Sequence[int | None]) -> np.ndarray:
    """``array`` as contiguous float32; InputError at ``where`` unless it has ``shape`` (None: any length),
    and numbers that are finite."""
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
    """``array`` as contiguous int32, checked for ``shape`` and ``low <= value < high``, as `floats`."""
    array = np.asarray(array)
    if array.dtype.kind not in "iu":
        raise InputError(where, f"type {array.dtype}", "int32")
    check_shape(where, array, shape)
    if array.size and (array.min() < low or array.max() >= high):
        raise InputError(where, f"values from {array.min()} to {array.max()}",
                         f"values from {low} to {high - 1}")
    return np.ascontiguousarray(array, dtype=np.int32)


@contextlib.contextmanager
def located(short: str, path: str | os.PathLike[str]) -> Iterator[None]:
    """In an InputError raised inside, replaces ``short`` at the start of its place by ``path``."""
    try:
        yield
    except InputError as error:
        where = os.fspath(path) + error.where.removeprefix(short)
        raise InputError(where, error.found, error.expected, error.repair) from None


def check_shape(where: str, array: np.ndarray, shape: Sequence[int | None]) -> None:
    """Raises InputError unless ``array`` has ``shape``, where None stands for any length."""
    fits = array.ndim == len(shape) and all(n is None or n == m
                                            for n, m in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise InputError(where, f"shape {array.shape}", f"shape ({wanted}{',' if len(shape) == 1 else ''})")
