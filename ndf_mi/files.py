"""Writing files so that a reader never sees half of one: beside the target, then renamed into place."""

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


@contextlib.contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yields a temporary path beside ``path``, with the same suffix; renames it to ``path`` if the block succeeds.

    On an exception the temporary file is removed and ``path`` stays as it was. Missing parent folders are made.

    Raises:
        InputError: there can be no such file: its folder cannot be made or written, or it is a folder itself.
    """
    target = Path(path)
    try:
        if target.is_dir():
            raise IsADirectoryError("it is a folder")
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise InputError(target, f"a place that cannot be written ({error})", "a file's name in a folder that can be written") from None
    os.close(handle)
    beside = Path(name)
    try:
        yield beside
        beside.chmod(0o666 & ~_UMASK)
        os.replace(beside, target)
    finally:
        beside.unlink(missing_ok=True)


def is_left_over(file: Path) -> bool:
    """Whether a file was being written by `replacing` when the process was killed: it is hidden, and of no use."""
    return re.fullmatch(r"\..*-[a-z0-9_]{8}(\.\w+)?", file.name) is not None


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes ``text`` as UTF-8 to ``path``, whole or not at all."""
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Writes ``value`` as indented JSON to ``path``, whole or not at all; NaN and infinity are refused (ValueError)."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def write_npz(path: str | os.PathLike[str], **arrays: np.ndarray) -> None:
    """Writes arrays as a compressed ``.npz`` to ``path``, whole or not at all; objects are refused (ValueError)."""
    with replacing(path) as beside, open(beside, "wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


