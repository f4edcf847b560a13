"""Digests of the package's sources, by which stored results become stale when the code changes."""

from __future__ import annotations

import functools
import hashlib
from importlib.util import find_spec
from pathlib import Path

import ndf_mi


@functools.cache
def code_digest() -> str:
    """SHA-256 (hex) of the sources that images are rendered by; unlike a version, it changes with every
    edit."""
    modules = ("model.py", "run.py", "numerics.py", "coordinates.py", "colour.py", "variants.py")
    return sources_digest("render", "field", "projection", *modules)


def sources_digest(*names: str) -> str:
    """SHA-256 (hex) of sources of the package.

    Args:
        names: modules (``model.py``) and folders (``render``), relative to the package; folders include all
            that is below them.

    Raises:
        FileNotFoundError: there is no such source.
    """
    state = hashlib.sha256()
    for name in names:
        source = _path(name)
        for file in [source] if source.is_file() else sorted(source.rglob("*.py")):
            state.update(f"{name} {file.relative_to(source)}".encode() + file.read_bytes())
    return state.hexdigest()


def _path(name: str) -> Path:
    spec = find_spec(f"ndf_mi.{name}") if "/" not in name and "." not in name else None
    # An editable installation keeps the plugins outside of the package's folder.
    folders = spec.submodule_search_locations if spec else None
    path = Path(folders[0]) if folders else Path(ndf_mi.__file__).parent / name
    if not path.exists():
        raise FileNotFoundError(path)
    return path
