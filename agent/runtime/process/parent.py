"""Processes that end with the one that began them, however that ends."""

import ctypes
import os
import signal
from typing import Final

_PR_SET_PDEATHSIG: Final = 1  # fixed by linux/prctl.h


def end_with_parent(parent: int) -> None:
    """Have the kernel send SIGTERM when the thread that began this process ends; parent: its process."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it had ended before the kernel was told
        os._exit(0)
