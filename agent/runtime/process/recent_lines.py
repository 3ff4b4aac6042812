"""The newest lines of the log, kept in memory for whoever asks what happened."""

import logging
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from agent.clock import wall_ns
from agent.text import iso_time, printable


class RecentLines(logging.Handler):
    """Keeps lines of the root logger, the newest last."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self._lines: deque[str] = deque(maxlen=most)

    def __iter__(self) -> Iterator[str]:
        return iter(self._lines.copy())

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a record as one line."""
        self._lines.append(
            f"{iso_time(wall_ns())} {record.levelname.lower()} {printable(record.getMessage())}"
        )

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep what is logged inside."""
        root = logging.getLogger()
        root.addHandler(self)
        try:
            yield
        finally:
            root.removeHandler(self)
