"""What a method takes: main memory while it trains, and space on disk."""

from __future__ import annotations

import ctypes
import gc
import tempfile
from collections.abc import Callable
from pathlib import Path

import drjit as dr

from ndf_mi.methods.base import Trainable

STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
"""Where Linux says how much memory this process held at most, and where that is reset."""
RESET_PEAK = "5"

NOT_COUNTED = ("metrics.jsonl", "body.npz", "poses.npz")
"""Files that rendering does not read, and those of a run that the capture holds as well, from which other
methods read them."""


def peak_memory(work: Callable[[], object]) -> int | None:
    """Bytes of main memory that this process held at most during `work`: all of it, with libraries, images
    and kernels. None where the system does not tell."""
    gc.collect()
    dr.sync_thread()
    dr.flush_malloc_cache()
    # What others have freed shall not count.
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:
        trim(0)
    try:
        CLEAR.write_text(RESET_PEAK)
    except OSError:
        work()
        return None
    work()
    return _status("VmHWM")


def size_on_disk(method: Trainable) -> int | None:
    """Bytes of the files that a method needs to render besides the capture, as it saves them; None of one
    that saves none."""
    with tempfile.TemporaryDirectory(prefix="ndf-mi-") as folder:
        method.save(folder)
        saved = (file for file in Path(folder).rglob("*") if file.is_file() and file.name not in NOT_COUNTED)
        return sum(file.stat().st_size for file in saved) or None


def _status(name: str) -> int | None:
    for line in STATUS.read_text().splitlines():
        if line.startswith(f"{name}:"):
            return 1024 * int(line.split()[1])
    return None
