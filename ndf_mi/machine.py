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
        "Cores": _cores(),
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


def _cores() -> str:
    """The cores that this process may use: those it may run on, or as many as its control groups grant it time for, where that is less."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return f"{min([float(cores), *_quotas()]):g}"


def _quotas(root: str = "/sys/fs/cgroup", own: str = "/proc/self/cgroup") -> list[float]:
    """Cores' worth of time that the control groups of this process, of either version and each up to its root, grant it."""
    found = []
    for line in _lines(own):
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        # Version 2 has one tree of groups and one file; version 1 has a tree for each controller, and two files.
        top = Path(root, controllers) if controllers else Path(root)
        if controllers and "cpu" not in controllers.split(","):
            continue
        folder = top / path.strip("/")
        for group in (folder, *folder.parents):
            text = " ".join(_lines(str(group / "cpu.max")) if not controllers else
                            _lines(str(group / "cpu.cfs_quota_us")) + _lines(str(group / "cpu.cfs_period_us")))
            quota, _, period = text.partition(" ")
            if quota.isdecimal() and period.isdecimal() and int(period) > 0:
                found.append(int(quota) / int(period))
            if group == top:
                break
    return found


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
