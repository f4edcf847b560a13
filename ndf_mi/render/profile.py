"""Profiles on disk: how fast and how accurately this machine renders a run.

A profile is a file in ``$XDG_CACHE_HOME/ndf-mi/profiles``, or ``~/.cache/ndf-mi/profiles``: one for each run,
image size and machine.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import msgspec

from ndf_mi import files, machine
from ndf_mi.errors import InputError
from ndf_mi.render.cost import Sample
from ndf_mi.render.measure import CUTOFFS, Profile, measure
from ndf_mi.render.settings import field_digest
from ndf_mi.run import Run
from ndf_mi.source_digest import code_digest

FORMAT = "ndf-profile"
VERSION = 3


@dataclass(frozen=True)
class Key:
    """What a profile is valid for: run, size and machine select its file; anything else makes it stale.

    Attributes:
        run: the folder.
        digest: of the field's architecture and weights.
        code: digest of the sources that images are rendered by.
        size, geometry: width and height, and whether (u, v, l) and normals are rendered.
        machine: hardware and versions.
    """

    run: str
    digest: str
    code: str
    size: tuple[int, int]
    geometry: bool
    machine: dict[str, str]

    @classmethod
    def of(cls, run: Run, size: tuple[int, int], geometry: bool) -> Key:
        """The current key; `geometry` is whether (u, v, l) and normals are rendered as well."""
        return cls(
            str(run.path.resolve()), field_digest(run), code_digest(), size, geometry, machine.describe())

    @property
    def file(self) -> Path:
        """Where the profile is stored."""
        fixed = [
            self.run, self.size, self.geometry,
            *(self.machine[name] for name in ("Processor", "Cores", "Variant"))]
        base = os.environ.get("XDG_CACHE_HOME", "")
        # The XDG specification says to ignore relative paths.
        cache = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
        name = f"{hashlib.sha256(repr(fixed).encode()).hexdigest()[:24]}.json"
        return cache / "ndf-mi" / "profiles" / name


@dataclass(frozen=True)
class _File:
    """A profile on disk."""

    format: str
    version: int
    key: Key
    opacity: float
    samples: list[Sample]


def load_or_measure(run: Run, size: tuple[int, int], geometry: bool, report: Callable[[str], None],
                    measure: Callable[..., Profile] = measure) -> Profile:
    """The stored profile, or a new one, which is then stored. `measure` makes a new one; the arguments are
    its."""
    key = Key.of(run, size, geometry)
    stored, reason = _read(key)
    if stored is not None:
        report(f"profile: {key.file}")
        return stored
    report(f"profile: {reason}; measuring this machine once")
    start = time.perf_counter()
    profile = measure(run, size, geometry, report)
    seconds = time.perf_counter() - start
    try:
        write(key, profile)
        report(f"profile: measured in {seconds:.0f} s, stored as {key.file}")
    except InputError as error:
        report(f"profile: measured in {seconds:.0f} s, but not stored: {error.found}")
    return profile


def write(key: Key, profile: Profile) -> None:
    """Stores a profile. Raises InputError if the file cannot be written."""
    files.write_json(key.file, asdict(_File(FORMAT, VERSION, key, profile.opacity, profile.samples)))


def _read(key: Key) -> tuple[Profile | None, str]:
    """The profile stored for a key; or None, and why: none is stored, it can't be read, or it is stale."""
    try:
        stored = msgspec.json.decode(key.file.read_bytes(), type=_File)
    except FileNotFoundError:
        return None, "none yet for this run at this size"
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None, "the stored one can't be read"
    if (stored.format, stored.version) != (FORMAT, VERSION):
        return None, "the stored one is of another version"
    if stored.key != key:
        changed = (
            "weights" if stored.key.digest != key.digest
            else "rendering code" if stored.key.code != key.code else "machine or versions")
        return None, f"the stored one is stale ({changed} changed)"
    if {s.cutoff for s in stored.samples if s.error is not None} != set(CUTOFFS):
        return None, "the stored one can't be read"
    return Profile(stored.samples, stored.opacity), ""
