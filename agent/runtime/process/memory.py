"""The heap of an agent that runs for months."""

import ctypes
import gc

from agent.runtime.tuning import LARGE_BYTES

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8
"""Fixed by malloc.h: parameters of mallopt(3), by its numbers in malloc.h."""


def keep_heap_small() -> None:
    """Have glibc share one heap among all threads and give large arrays back; elsewhere it does nothing."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for parameter, value in (
            (ARENA_MAX, 1),
            (MMAP_THRESHOLD, LARGE_BYTES),
            (TRIM_THRESHOLD, LARGE_BYTES),
        ):
            mallopt(parameter, value)


def release_free_pages() -> None:
    """Give back what starting has left free: garbage of the imports, and glibc's free pages."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
