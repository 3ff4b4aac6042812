"""A serial line: a pseudo-terminal whose far end readers open by a link of the configured name."""

import os
import select
import threading
import tty
from pathlib import Path

from sim_bus.errors import SimBusError
from sim_bus.tuning import READ_BYTES


class PtyLine:
    """The device's end of a pseudo-terminal.

    Args:
        link: where to make the link to the readers' end; None for no link.
    """

    def __init__(self, link: Path | None) -> None:
        self._link = link
        self._master = -1
        self._far = ""
        # a line may be hung up by one thread while another carries bytes over it
        self._lock = threading.RLock()

    @property
    def path(self) -> str:
        """Where readers open the line."""
        return str(self._link or self._far)

    @property
    def is_open(self) -> bool:
        """Whether the line is there."""
        return self._master >= 0

    def open(self) -> None:
        """Make the line, raw and without echo; SimBusError when the link cannot be made."""
        self._master, far = os.openpty()
        tty.setraw(far)
        self._far = os.ttyname(far)
        os.close(far)
        os.set_blocking(self._master, False)
        if self._link is not None:
            self._make_link(self._link)

    def _make_link(self, link: Path) -> None:
        fresh = link.with_name(f".{link.name}.{os.getpid()}")
        try:
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self._far)
            fresh.replace(link)
        except OSError as error:
            self.close()
            raise SimBusError(
                f"{link}: the link to the serial line cannot be made: {error.strerror}"
            ) from error

    def has_reader(self) -> bool:
        """Tell whether somebody has the far end open."""
        with self._lock:
            if not self.is_open:
                return False
            poll = select.poll()
            poll.register(self._master, 0)
            return not any(event & select.POLLHUP for _, event in poll.poll(0))

    def write(self, data: bytes, timeout_s: float = 0.0) -> int:
        """Write as much as the line takes within timeout_s; return how many bytes that were."""
        with self._lock:
            if not self.is_open or not select.select([], [self._master], [], timeout_s)[1]:
                return 0
            try:
                return os.write(self._master, data)
            except BlockingIOError:
                return 0

    def read(self) -> bytes:
        """Return what readers have written; b"" for nothing."""
        with self._lock:
            try:
                return os.read(self._master, READ_BYTES)
            except OSError:
                # nothing has come, nobody has the far end open, or the line is hung up
                return b""

    def close(self) -> None:
        """Hang up and remove the link; harmless when closed already."""
        with self._lock:
            if self._master < 0:
                return
            os.close(self._master)
            self._master = -1
        if self._link is not None and self._link.is_symlink() and str(self._link.readlink()) == self._far:
            self._link.unlink()

    def wait(self, other: "PtyLine", timeout_s: float) -> None:
        """Return when something has come over this line or the other, or after timeout_s."""
        with self._lock:
            descriptors = [line._master for line in (self, other) if line.is_open]  # noqa: SLF001 (of its own kind)
        poll = select.poll()
        for descriptor in descriptors:
            poll.register(descriptor, select.POLLIN)
        poll.poll(timeout_s * 1000.0)


def join(outer: PtyLine, inner: PtyLine, stop: threading.Event) -> None:
    """Carry bytes between a line that readers come to and go from and one always open, until told to stop."""
    while not stop.is_set():
        if not outer.has_reader():
            stop.wait(0.005)
            continue
        outer.wait(inner, 0.05)
        _carry(outer, inner)
        _carry(inner, outer)


def _carry(source: PtyLine, sink: PtyLine) -> None:
    data = source.read()
    while data and sink.has_reader():
        data = data[sink.write(data, 0.1) :]
