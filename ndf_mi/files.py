"""Reads text, and writes files atomically: next to the target, then renamed into place."""

from __future__ import annotations

import contextlib
import json
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ndf_mi.errors import InputError

_UMASK = os.umask(0)
os.umask(_UMASK)


def read_lines(path: Path, expected: str) -> list[str]:
    """The lines of a UTF-8 file. Raises InputError with what is ``expected`` if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InputError(path, "no such file", expected) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"a file that cannot be read as text ({error})", expected) from None


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path next to ``path``; renames it to ``path`` if the block succeeds.

    On an exception the temporary file is removed and ``path`` stays unchanged. Missing parent folders are
    created.

    Raises:
        InputError: the file cannot be written, or ``path`` is a folder.
    """
    target = Path(path)
    try:
        if target.is_dir():
            raise IsADirectoryError("it is a folder")
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise InputError(target, f"a path that cannot be written ({error})",
                         "a file name in a writable folder") from None
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o666 & ~_UMASK)
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def is_left_over(file: Path) -> bool:
    """Whether a hidden file was left by `replacing` in a process that was killed, and can be ignored."""
    return re.fullmatch(r"\..*-[a-z0-9_]{8}(\.\w+)?", file.name) is not None


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes ``text`` as UTF-8 to ``path``, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Writes ``value`` as indented JSON to ``path``, atomically; NaN and infinity raise ValueError."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def write_npz(path: str | os.PathLike[str], **arrays: np.ndarray) -> None:
    """Writes arrays as a compressed ``.npz`` to ``path``, atomically; Python objects raise ValueError."""
    with replacing(path) as temporary, open(temporary, "wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


