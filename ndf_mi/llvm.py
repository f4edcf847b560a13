"""Finds an LLVM that Dr.Jit can use, and points Dr.Jit at it before Dr.Jit looks for itself.

Dr.Jit takes the first ``libLLVM.so`` that the loader finds, or else the highest file name in the system's
library folder. It accepts LLVM 15 and 16, and then aborts the process at the first ``dr.maximum``. It reads
``DRJIT_LIBLLVM_PATH`` once, on import, so the choice is made here, earlier. This module imports neither drjit
nor mitsuba. It also runs alone, as ``python -I ndf_mi/llvm.py``, before anything is installed: it prints the
LLVM that it finds, or the command that installs one, with exit code 1.
"""

from __future__ import annotations

import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

MINIMUM = 17
VARIABLE = "DRJIT_LIBLLVM_PATH"
PACKAGES = {"debian": "libllvm19", "fedora": "llvm-libs", "arch": "llvm-libs", "suse": "libLLVM19",
            "darwin": "llvm"}
"""The system's package with LLVM's shared library, by kind of system."""
ABSENT = "/nonexistent/libLLVM-17-or-newer.so"
"""The value of ``DRJIT_LIBLLVM_PATH`` without a usable LLVM: Dr.Jit then finds none, instead of 15 or 16."""


@dataclass(frozen=True, order=True)
class Llvm:
    """A shared library of LLVM: its version (major, minor, patch) and path."""

    version: tuple[int, int, int]
    path: str

    def __str__(self) -> str:
        return f"LLVM {'.'.join(map(str, self.version))}" + (f" ({self.path})" if self.path else "")


def folders() -> list[Path]:
    """The folders that are searched for shared libraries of LLVM, besides the loader's cache."""
    if sys.platform == "darwin":
        roots = (Path("/opt/homebrew/opt"), Path("/usr/local/opt"))
        return [path / "lib" for root in roots for path in sorted(root.glob("llvm*"))]
    system = Path("/usr/lib")
    plain = [system, Path("/usr/lib64"), Path("/usr/local/lib"), *sorted(system.glob("*-linux-gnu*"))]
    return plain + [path / "lib" for path in sorted(system.glob("llvm*"))]


def candidates() -> Iterator[Path]:
    """Every file that looks like a shared library of LLVM, without links to the same file."""
    seen: set[Path] = set()
    patterns = ("libLLVM*.so*", "libLLVM*.dylib")
    found = (path for folder in folders() for pattern in patterns for path in sorted(folder.glob(pattern)))
    for path in (*found, *in_loader_cache()):
        real = path.resolve()
        if real not in seen and real.is_file():
            seen.add(real)
            yield path


def version_of(path: str | os.PathLike[str]) -> tuple[int, int, int] | None:
    """The version that the library at ``path`` reports; None if it cannot be loaded or is not LLVM.

    Up to LLVM 15 the library cannot report its version, which is then read from its file name. The library is
    loaded into this process: LLVM's symbols are versioned and local (``RTLD_LOCAL``), so that a second LLVM
    does no harm.
    """
    try:
        library = ctypes.CDLL(os.fspath(path), mode=ctypes.RTLD_LOCAL)
    except OSError:
        return None
    if not hasattr(library, "LLVMGetVersion"):
        return version_in_name(path) if hasattr(library, "LLVMContextCreate") else None
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    library.LLVMGetVersion(*map(ctypes.byref, (major, minor, patch)))
    return major.value, minor.value, patch.value


def version_in_name(path: str | os.PathLike[str]) -> tuple[int, int, int] | None:
    """The version in a name such as ``libLLVM-15.so.1`` or ``libLLVM.so.19.1``; or None.

    Links are followed, since ``libLLVM.so`` alone has no version; a folder such as ``llvm-14/lib`` counts
    too.
    """
    for text in (os.path.basename(path), os.path.realpath(path)):
        match = re.search(r"(?:libLLVM-|libLLVM\.so\.|llvm-)(\d+)(?:\.(\d+))?(?:\.(\d+))?", text)
        if match:
            major, minor, patch = (int(group or 0) for group in match.groups())
            return major, minor, patch
    return None


def usable(path: str | os.PathLike[str]) -> Llvm | None:
    """The library at ``path``, if it can be loaded and is new enough; else None."""
    named = version_in_name(path)
    if named is not None and named[0] < MINIMUM:
        return None  # too old; there is no need to load 100 MB
    version = version_of(path)
    return Llvm(version, os.fspath(path)) if version is not None and version[0] >= MINIMUM else None


def find() -> Llvm | None:
    """The newest usable LLVM on this machine, or None."""
    by_name = sorted(candidates(), key=lambda path: version_in_name(path) or (0, 0, 0), reverse=True)
    return next((llvm for path in by_name if (llvm := usable(path))), None)


def loaded() -> Llvm | None:
    """The LLVM that Dr.Jit has loaded, or None. Dr.Jit must be imported.

    The path is known only on Linux, and empty elsewhere.
    """
    import drjit as dr

    major, minor, patch = dr.detail.llvm_version()
    if major < 0:
        return None
    maps = Path("/proc/self/maps")
    lines = maps.read_text().splitlines() if maps.is_file() else []
    paths = {os.path.realpath(line.split(maxsplit=5)[5]) for line in lines if "libLLVM" in line}
    named = [path for path in sorted(paths) if (version_in_name(path) or (0,))[0] == major]
    return Llvm((major, minor, patch), named[0] if named else "")


def ensure_llvm() -> Llvm | None:
    """Makes Dr.Jit use a usable LLVM or none. Call it before drjit is imported.

    It sets ``DRJIT_LIBLLVM_PATH`` to the newest usable LLVM, unless the variable names a usable one already.
    If there is none, it sets a path that does not exist: CUDA variants still work, and LLVM variants report
    that LLVM was not found, instead of aborting the process.

    Returns:
        The LLVM that Dr.Jit will use, or None.

    Raises:
        ImportError: drjit was imported earlier, with an LLVM that is too old.
    """
    if "drjit" in sys.modules:
        return _check_loaded()
    chosen = os.environ.get(VARIABLE)
    llvm = (usable(chosen) if chosen else None) or find()
    os.environ[VARIABLE] = llvm.path if llvm else ABSENT
    return llvm


def install_command(packages: Mapping[str, str] = PACKAGES) -> str:
    """The command that installs a package on this system; `packages` has its name by kind of system."""
    if sys.platform == "darwin":
        return f"brew install {packages['darwin']}"
    try:
        release = Path("/etc/os-release").read_text()
    except OSError:
        release = ""
    kinds = " ".join(re.findall(r"^ID(?:_LIKE)?=\"?([^\"\n]*)", release, re.MULTILINE))
    prefix = "" if os.geteuid() == 0 else "sudo "
    for kind, tool in (("fedora", "dnf install"), ("arch", "pacman -S"), ("suse", "zypper install")):
        if kind in kinds:
            return f"{prefix}{tool} {packages[kind]}"
    return f"{prefix}apt-get update && {prefix}apt-get install -y {packages['debian']}"


def _check_loaded() -> Llvm | None:
    llvm = loaded()
    if llvm is None or llvm.version[0] >= MINIMUM:
        return llvm
    better = find()
    repair = (f"Import ndf_mi before drjit and mitsuba, or set {VARIABLE}={better.path}" if better else
              f"Install one: {install_command()}")
    raise ImportError(
        f"Dr.Jit has loaded {llvm}, which aborts the process at the first render; LLVM {MINIMUM} "
        f"or newer is needed.\n  {repair}"
    )


def in_loader_cache() -> Iterator[Path]:
    """The libraries of LLVM in the cache of the system's loader (Linux)."""
    for tool in ("ldconfig", "/sbin/ldconfig"):
        try:
            done = subprocess.run([tool, "-p"], capture_output=True, text=True, timeout=10, check=True)
        except (OSError, subprocess.SubprocessError):
            continue
        for line in done.stdout.splitlines():
            if "libLLVM" in line and "=>" in line:
                yield Path(line.split("=>")[1].strip())
        return


if __name__ == "__main__":
    found = find()
    print(found or install_command())
    sys.exit(0 if found else 1)
