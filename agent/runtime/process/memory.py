"""The heap of an agent that runs for months."""

import ctypes
import gc
import re
from pathlib import Path

from agent.runtime.tuning import LARGE_BYTES

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8
"""Fixed by malloc.h: parameters of mallopt(3), by its numbers in malloc.h."""

_DONTNEED = 4  # fixed by madvise(2)
_TEXT = re.compile(r"^(\w+)-(\w+) r-.p \w+ \S+ [1-9].*\n(?:[A-Z].*\n)*?Anonymous: +0 kB", re.MULTILINE)
"""A mapping of a file in proc_pid_smaps(5) that cannot be written to, and of which no page is private."""


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
    """Give back what is not needed now: garbage, glibc's free pages, text that only the start ran."""
    gc.collect()
    libc = ctypes.CDLL(None)
    trim = getattr(libc, "malloc_trim", None)
    if trim is not None:
        trim(0)
    for start, end in _text():
        libc.madvise(ctypes.c_void_p(start), ctypes.c_size_t(end - start), _DONTNEED)


def _text() -> list[tuple[int, int]]:
    """Return where files are mapped that nothing was written to: their pages come back from the page cache.

    Of libraries' text and tables a third is used by imports only. None where the kernel tells nothing.
    """
    smaps = Path("/proc/self/smaps")
    found = _TEXT.findall(smaps.read_text(encoding="utf-8")) if smaps.exists() else []
    return [(int(start, 16), int(end, 16)) for start, end in found]
