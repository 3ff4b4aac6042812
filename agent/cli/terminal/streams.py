"""stdout and stderr as a command line meets them: closed, full, or without a reader; none is unforeseen."""

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO, cast

from agent.errors import UsageError


class ReaderGoneError(Exception):
    """Whoever read stdout has gone, as in `deltak estimates ... | head`."""


class _Output:
    """A stream whose failures are what `failed` makes of them; libraries would end the process themselves."""

    def __init__(self, stream: TextIO, failed: Callable[[OSError], None]) -> None:
        self._stream, self._failed = stream, failed
        self.is_used = False
        """Whether anything was written."""

    def write(self, text: str) -> int:
        """Write text; what could not be written is thrown away."""
        self.is_used |= bool(text)
        try:
            return self._stream.write(text)
        except UnicodeEncodeError as error:  # a terminal that knows fewer characters
            return self.write(text.encode(error.encoding, "replace").decode(error.encoding))
        except OSError as error:
            self._fail(error)
            return len(text)

    def flush(self) -> None:
        """Write what waits."""
        try:
            self._stream.flush()
        except OSError as error:
            self._fail(error)

    def _fail(self, error: OSError) -> None:
        # what waits, and what comes until the process ends, finds a reader
        os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
        self._failed(error)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def guarded_streams() -> Iterator[None]:
    """Have stdout raise ReaderGoneError or UsageError on failure, stderr be silent; closed ones take all."""
    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _watched(sys.stdout, _stdout_failed), _watched(sys.stderr, _ignore)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


def _watched(stream: TextIO | None, failed: Callable[[OSError], None]) -> TextIO:
    """Return a stream that is watched; one that throws all away where there is none."""
    if stream is None:
        return Path(os.devnull).open("w", encoding="utf-8")
    return cast("TextIO", _Output(stream, failed))


def _stdout_failed(error: OSError) -> None:
    if isinstance(error, BrokenPipeError):
        raise ReaderGoneError from error
    what = f"cannot be written: {error.strerror or error}"
    raise UsageError.at("stdout", what, "make room there, or send it elsewhere") from error


def _ignore(_error: OSError) -> None:
    """Say nothing: nobody could read it."""
