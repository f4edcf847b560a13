"""What machine and which versions figures were measured with."""

from __future__ import annotations

import os
import platform
from pathlib import Path

import drjit as dr
import mitsuba as mi

import ndf_mi


def describe() -> dict[str, str]:
    """Label → value, for people to read: processor, cores, memory, system, versions, variant."""
    return {
        "Processor": _processor(),
        "Cores": str(_cores()),
        "Memory": _memory(),
        "System": platform.platform(),
        "Variant": str(mi.variant()),
        "Versions": ", ".join(
            f"{name} {version}"
            for name, version in (
                ("ndf-mi", ndf_mi.__version__),
                ("Mitsuba", mi.__version__),
                ("Dr.Jit", dr.__version__),
                ("LLVM", _llvm()),
                ("Python", platform.python_version()),
            )
        ),
    }


def _cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    for line in _lines("/proc/cpuinfo"):
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _memory() -> str:
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemTotal"):
            return f"{int(line.split()[1]) / 2**20:.1f} GiB"
    return "unknown"


def _llvm() -> str:
    version = dr.detail.llvm_version()
    return ".".join(map(str, version)) if version else "none"


def _lines(path: str) -> list[str]:
    file = Path(path)
    return file.read_text(encoding="utf-8", errors="replace").splitlines() if file.is_file() else []
