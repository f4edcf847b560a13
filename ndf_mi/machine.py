"""Describes the machine and the versions that figures were measured with."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from pathlib import Path

import drjit as dr
import mitsuba as mi

import ndf_mi


def describe() -> dict[str, str]:
    """Label → value, for people to read: processor, cores, memory, system, versions, variant."""
    llvm = dr.detail.llvm_version()
    versions = {
        "ndf-mi": ndf_mi.__version__, "Mitsuba": mi.__version__, "Dr.Jit": dr.__version__,
        "LLVM": ".".join(map(str, llvm)) if llvm else "none", "Python": platform.python_version()}
    return {
        "Processor": _processor(), "Cores": f"{usable_cores(cpu_quotas()):g}", "Memory": _memory(),
        "System": platform.platform(), "Variant": str(mi.variant()),
        "Versions": ", ".join(f"{name} {version}" for name, version in versions.items())}


def usable_cores(quotas: Sequence[float]) -> float:
    """Cores that this process may use: those it may run on, or the least of the `quotas`, if that is less."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min([float(cores), *quotas])


def cpu_quotas(
    root: str | os.PathLike[str] = "/sys/fs/cgroup", own: str | os.PathLike[str] = "/proc/self/cgroup"
) -> list[float]:
    """CPU time, in cores, that each limited control group of this process, or parent of one, allows.

    Args:
        root: where control groups are mounted, version 1 or 2.
        own: the list of the process's groups.
    """
    found = []
    for line in _lines(own):
        _, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        # Version 2 has a single tree, and both numbers in one file. Version 1 has a tree for each controller,
        # and two files.
        if controllers and "cpu" not in controllers.split(","):
            continue
        tree = Path(root, controllers)
        names = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if controllers else ("cpu.max",)
        folder = tree / path.strip("/")
        for group in (folder, *folder.parents):
            text = " ".join(line for name in names for line in _lines(group / name))
            quota, _, period = text.partition(" ")
            if quota.isdecimal() and period.isdecimal() and int(period) > 0:
                found.append(int(quota) / int(period))
            if group == tree:
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


def _lines(path: str | os.PathLike[str]) -> list[str]:
    file = Path(path)
    return file.read_text(encoding="utf-8", errors="replace").splitlines() if file.is_file() else []
