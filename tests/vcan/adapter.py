"""The kernel's own slcan: a line discipline on a pseudo-terminal whose far end the test plays, as an adapter
would."""

import fcntl
import os
import select
import struct
import subprocess
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager

DEADLINE_S = 20.0
_SLCAN = 17
_INTERFACE_NAME = 0x8910


class KernelAdapter:
    """A CAN interface of the kernel, made from a line; what the kernel writes to its adapter is taken down.

    Attributes:
        name: of the interface.
        asked: all bytes that came from the kernel.
        to: told of them as they come.
    """

    def __init__(self, *, attach: bool = True) -> None:
        self.asked = b""
        self.to: Callable[[bytes], object] = len
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.name = ""
        if attach:
            fcntl.ioctl(self.slave, termios.TIOCSETD, struct.pack("i", _SLCAN))
            self.name = fcntl.ioctl(self.slave, _INTERFACE_NAME, bytes(16)).rstrip(b"\0").decode()
        self._stop = False
        self._thread = threading.Thread(target=self._take)
        self._thread.start()

    def _take(self) -> None:
        while not self._stop:
            if select.select([self.master], [], [], 0.05)[0]:
                data = os.read(self.master, 4096)
                self.asked += data
                self.to(data)

    def up(self, *words: str) -> None:
        subprocess.run(
            ["ip", "link", "set", self.name, "type", "can", "bitrate", "500000", *words], check=True
        )
        subprocess.run(["ip", "link", "set", self.name, "up"], check=True)

    def send(self, text: bytes) -> None:
        os.write(self.master, text)

    def until_asked(self, text: bytes) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while text not in self.asked:
            assert time.monotonic() < deadline, f"the kernel wrote {self.asked!r}, not {text!r}"
            time.sleep(0.005)

    def close(self) -> None:
        self._stop = True
        self._thread.join()
        os.close(self.slave)
        os.close(self.master)


@contextmanager
def kernel_adapter(*words: str) -> Iterator[KernelAdapter]:
    """Make an interface, set up with `words` of `ip link set can0 type can`, and take it away."""
    adapter = KernelAdapter()
    try:
        adapter.up(*words)
        yield adapter
    finally:
        adapter.close()
