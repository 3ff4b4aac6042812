"""Logs on stderr: warnings by default, more with -v; a fault that repeats is one line a minute."""

import logging
import sys
from collections.abc import Callable
from time import monotonic

from agent.cli.tuning import REPEAT_S
from agent.text import printable

THIRD_PARTY = ("pymodbus", "can", "asyncio", "matplotlib", "sqlite_utils", "py.warnings")
"""What speaks only where logs are set to debug; Python's warnings (numpy's, scipy's) are the last of them."""


class OncePerPeriod(logging.Filter):
    """Let a warning or worse through once a period; the next one says how many were held back.

    What counts as the same: logger, format string and first argument, which names the source, so a fault
    whose figures differ each time is still one fault.
    """

    def __init__(self, period_s: float = REPEAT_S, now_s: Callable[[], float] = monotonic) -> None:
        super().__init__()
        self._period_s, self._now_s = period_s, now_s
        self._shown: dict[tuple[str, str, str], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Tell whether to write a record."""
        if record.levelno < logging.WARNING:
            return True
        first = record.args[0] if isinstance(record.args, tuple) and record.args else ""
        key = (record.name, str(record.msg), str(first))
        since, held = self._shown.get(key, (-self._period_s, 0))
        now = self._now_s()
        if now - since < self._period_s:
            self._shown[key] = (since, held + 1)
            return False
        if (
            len(self._shown) >= 1000
        ):  # names come from configurations, but a bug elsewhere must not eat the memory
            self._shown.clear()
        self._shown[key] = (now, 0)
        if held:
            record.msg = f"{record.getMessage()} ({held} more since the last line)"
            record.args = None
        return True


class OneLine(logging.Formatter):
    """Write `deltak: warning: text`, as errors are written."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as one line; tracebacks only where logs are set to debug."""
        line = f"deltak: {record.levelname.lower()}: {record.getMessage()}"
        if record.exc_info and logging.getLogger().isEnabledFor(logging.DEBUG):
            line += "\n" + self.formatException(record.exc_info)
        return printable(line)


def set_up_logging(verbose: int, *, debug: bool = False) -> None:
    """Send logs to stderr: warnings, with verbose 1 progress as well, with 2 or debug everything."""
    level = logging.DEBUG if debug or verbose > 1 else logging.INFO if verbose else logging.WARNING
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(OneLine())
    handler.addFilter(OncePerPeriod())
    logging.basicConfig(level=level, handlers=[handler], force=True)
    logging.captureWarnings(capture=True)
    for name in THIRD_PARTY:
        logging.getLogger(name).setLevel(level if level == logging.DEBUG else logging.CRITICAL)
