"""Peak memory as Dr.Jit counts it."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import TypeVar

import drjit as dr
import mitsuba as mi

T = TypeVar("T")

MEANING = (
    "the peak of Dr.Jit's allocations while rendering, minus what was allocated before; blocks that it keeps "
    "for reuse count. "
    "It excludes ray tracing acceleration structures, numpy arrays and compiled kernels."
)


def peak_memory(draw: Callable[[], T]) -> tuple[T, int]:
    """The result of `draw`, and by how many bytes Dr.Jit's allocations grew at most while it ran.

    The cache of freed blocks is emptied first, so that reused blocks count too.
    """
    gc.collect()
    dr.sync_thread()
    dr.flush_malloc_cache()
    dr.detail.malloc_clear_statistics()
    backend = dr.backend_v(mi.Float)
    before = dr.detail.malloc_watermark(backend)
    result = draw()
    dr.sync_thread()
    return result, int(dr.detail.malloc_watermark(backend) - before)
