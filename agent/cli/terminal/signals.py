"""SIGTERM: whatever a command is doing, it puts away what it holds and leaves with exit code 0; SIGINT: 130.

SIGHUP waits until the command is known: the agent reloads, and nothing else can. Imports nothing that takes
time, so that it can stand before all that does.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130  # fixed by POSIX shells: exit code after SIGINT
AGENT = "run"
"""The command that SIGHUP asks to reload, once it can (`agent.runtime.process.requests`)."""


class Terminated(BaseException):
    """SIGTERM has come; like KeyboardInterrupt it is no error and passes every `except Exception`."""


@contextmanager
def done_when_terminated() -> Iterator[None]:
    """Turn SIGTERM into an exception inside, and that into exit code 0; a command may have its own end."""
    previous = signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    except Terminated:
        sys.stderr.write("deltak: ended by SIGTERM\n")
        sys.exit(0)
    finally:
        outermost = previous is signal.SIG_DFL
        # nothing is left to end from here on, and the process must not be killed while it leaves
        signal.signal(signal.SIGTERM, signal.SIG_IGN if outermost else previous)


def _terminate(_number: int, _frame: FrameType | None) -> None:
    raise Terminated


def hold_reload_signal() -> None:
    """Let a SIGHUP wait from here on, unless a closed terminal may send it: that ends any command."""
    if not os.isatty(0):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP})


def release_reload_signal(command: str | None) -> None:
    """Let a SIGHUP that was held do to a command what it does at any time; one that reloads asks for it."""
    if command != AGENT:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGHUP})


def interrupted() -> int:
    """Say that SIGINT ended the command; return its exit code."""
    sys.stderr.write("deltak: interrupted\n")
    return INTERRUPTED
