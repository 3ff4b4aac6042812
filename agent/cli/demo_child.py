"""A command of deltak as a child of the demo: it ends when its parent does, even where that is killed.

`python -m agent.cli.demo_child PARENT ARGUMENT...`
"""

import ctypes
import os
import signal
import sys
from typing import NoReturn

from agent.cli.entry import main

_PR_SET_PDEATHSIG = 1


def _end_with(parent: int) -> None:
    """Have Linux send SIGTERM to this process when its parent ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:  # it had ended before the kernel was told
        sys.exit(0)


def run() -> NoReturn:
    """Run the command line that follows the parent's number."""
    _end_with(int(sys.argv[1]))
    del sys.argv[1]
    main()


if __name__ == "__main__":
    run()
