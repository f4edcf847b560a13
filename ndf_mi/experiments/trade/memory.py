"""How much memory something takes, by Dr.Jit's own count."""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import TypeVar

import drjit as dr
import mitsuba as mi

T = TypeVar("T")

MEANING = ("the most that Dr.Jit had allocated for arrays while drawing, beyond what lay there before; blocks that it keeps for reuse "
           "count. Ray tracing's trees, numpy's arrays and compiled kernels are not in it.")


def peak_memory(draw: Callable[[], T]) -> tuple[T, int]:
    """What `draw` returns, and the bytes by which Dr.Jit's allocations grew at most meanwhile, beyond those before.

    The cache of freed blocks is emptied before, so that what is reused counts, too: the next call finds an empty cache.
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
