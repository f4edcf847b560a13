"""Examines the machine and its packages, also where Mitsuba and Dr.Jit are broken."""

from __future__ import annotations

import ctypes
import enum
import importlib.metadata
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from ndf_mi import llvm, optional, variants
from ndf_mi.errors import InputError

LIBATOMIC = {"debian": "libatomic1", "fedora": "libatomic", "arch": "gcc-libs", "suse": "libatomic1"}
MEMORY_OF_DEMO = 6.0
"""GB of memory that ``ndf-mi demo`` may need."""
PROBE_SECONDS = 120
EXTRAS = {
    "atlas": "to flatten a body that comes without texture coordinates into one chart",
    "character": "to read glTF characters that are compressed by meshopt",
    "report": "for comparisons and their reports",
    "stability": "for `ndf-mi stability`",
    "tensorboard": "for a training's TensorBoard events",
    "video": "to write videos",
}
"""What each extra of the package is needed for."""

# The maximum is what makes an unsuitable LLVM abort the process.
PROBE = """
import sys, ndf_mi, mitsuba as mi, drjit as dr
mi.set_variant(sys.argv[1])
camera = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
film = {"type": "hdrfilm", "width": 8, "height": 8}
image = mi.render(mi.load_dict({
    "type": "scene", "integrator": {"type": "path"}, "light": {"type": "constant"},
    "ball": {"type": "sphere"}, "sensor": {"type": "perspective", "to_world": camera, "film": film}}), spp=4)
assert float(dr.mean(dr.maximum(image, 0), axis=None).array[0]) > 0
"""


class State(enum.Enum):
    """What a finding is: in order, missing, or for information only."""

    OK = enum.auto()
    MISSING = enum.auto()
    NOTE = enum.auto()


@dataclass(frozen=True)
class Finding:
    """One line of the examination; ``repair`` is the command that repairs it, or empty."""

    name: str
    state: State
    found: str
    repair: str = ""


def examine() -> list[Finding]:
    """Examines all that the package depends on. Takes some seconds: each variant renders a picture."""
    return [
        *_packages(),
        *_extras(),
        *_libatomic(),
        _llvm(),
        *(_variant(name) for name in variants.SUPPORTED),
        _gpu(),
        _body_data(),
        _memory(),
        Finding("cores", State.NOTE, f"{_cores()}"),
        Finding("system", State.NOTE, f"{platform.platform()}, Python {platform.python_version()}"),
    ]


def healthy(findings: Sequence[Finding]) -> bool:
    """Whether at least one variant renders and the default body's data are installed."""
    ok = {finding.name for finding in findings if finding.state is State.OK}
    return "body data" in ok and not ok.isdisjoint(variants.SUPPORTED)


def probe(variant: str) -> str:
    """Renders a few pixels in a process of its own; returns what went wrong in one line, or ``""``."""
    try:
        result = subprocess.run(
            [sys.executable, "-c", PROBE, variant], capture_output=True, text=True, timeout=PROBE_SECONDS
        )
    except subprocess.TimeoutExpired:
        return f"no image after {PROBE_SECONDS} s"
    if result.returncode == 0:
        return ""
    lines = [line.strip() for line in result.stderr.splitlines() if line.strip()]
    last = lines[-1] if lines else "no message"
    return f"the process died of signal {-result.returncode}: {last}" if result.returncode < 0 else last


def _variant(name: str) -> Finding:
    trouble = probe(name)
    if not trouble:
        return Finding(name, State.OK, "renders")
    if name == variants.CUDA:
        if shutil.which("nvidia-smi") is None:
            return Finding(name, State.NOTE, "no NVIDIA driver; optional, only faster")
        return Finding(name, State.MISSING, trouble,
                       "update the NVIDIA driver to 570 or newer, with its OptiX library")
    if llvm.find() is None:
        return Finding(name, State.MISSING, "no usable LLVM", llvm.install_command())
    if library := _libatomic():
        return Finding(name, State.MISSING, library[0].found, library[0].repair)
    return Finding(name, State.MISSING, trouble,
                   _pip("install", "--force-reinstall", "--no-deps", "mitsuba", "drjit"))


def _libatomic() -> list[Finding]:
    """Checks for libatomic, which Dr.Jit's wheel needs and minimal systems lack."""
    if not sys.platform.startswith("linux"):
        return []
    try:
        ctypes.CDLL("libatomic.so.1")
    except OSError as error:
        return [Finding("libatomic", State.MISSING, f"{error}", llvm.install_command(LIBATOMIC))]
    return []


def _llvm() -> Finding:
    chosen = os.environ.get(llvm.VARIABLE, "")
    found = (llvm.usable(chosen) if chosen else None) or llvm.find()
    if found is not None:
        return Finding("LLVM", State.OK, str(found))
    old = sorted({version for path in llvm.candidates() if (version := llvm.version_in_name(path))})
    versions = ", ".join(".".join(map(str, version)) for version in old)
    what = f"only too old ones ({versions})" if old else "none"
    return Finding("LLVM", State.MISSING, f"{what}; {variants.NEEDED} is needed", llvm.install_command())


def _gpu() -> Finding:
    query = ["nvidia-smi", "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
    try:
        result = subprocess.run(query, capture_output=True, text=True, timeout=30, check=True)
    except (OSError, subprocess.SubprocessError):
        return Finding("GPU", State.NOTE, "none that NVIDIA's driver reports")
    return Finding("GPU", State.OK, "; ".join(result.stdout.strip().splitlines()))


def _body_data() -> Finding:
    try:
        return Finding("body data", State.OK, str(optional.find_body_data()))
    except InputError:
        return Finding("body data", State.MISSING, "none", _pip("install", "--no-deps", optional.BODY))


def _packages() -> list[Finding]:
    names = optional.requirements().get("", [])
    missing = optional.missing_packages(names)
    found = [f"{name} {importlib.metadata.version(name)}" for name in names if name not in missing]
    findings = [Finding("packages", State.OK, ", ".join(found))]
    if missing:
        findings.append(Finding("packages", State.MISSING, ", ".join(missing), _pip("install", *missing)))
    return findings


def _extras() -> list[Finding]:
    """One finding for each extra whose packages are not all installed; those for developers are left out."""
    extras = {extra: names for extra, names in optional.requirements().items() if extra in EXTRAS}
    lacking = {extra: optional.missing_packages(names) for extra, names in extras.items()}
    return [Finding(f"extra {extra}", State.NOTE,
                    f"not installed: {', '.join(missing)}; needed {EXTRAS[extra]}",
                    optional.install_command(extra)) for extra, missing in lacking.items() if missing]


def _memory() -> Finding:
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    except (ValueError, OSError):
        return Finding("memory", State.NOTE, "not reported by the system")
    if total >= MEMORY_OF_DEMO:
        return Finding("memory", State.OK, f"{total:.1f} GB")
    return Finding("memory", State.NOTE, f"{total:.1f} GB; `ndf-mi demo` may take {MEMORY_OF_DEMO:.0f} GB")


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _pip(*arguments: str) -> str:
    return shlex.join([sys.executable, "-m", "pip", *arguments])
