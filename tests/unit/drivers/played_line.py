"""A Modbus device on a played machine: time moves when the driver waits, and answers come when the device is
told."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from drivers.clock import playing
from drivers.pipe import Pipe, PlayedMachine
from drivers.port import Driver, DriverIOError
from drivers.write_gate import check

Answer = Callable[[bytes], tuple[bytes, float]]
"""Takes a request, gives the reply and how long the device works at it, s."""


class PlayedLine(PlayedMachine):
    """One line to one device that answers one request after another, however late.

    Attributes:
        answer: the device.
        requests: what it was asked, with the times.
        connections: how often the line was opened.
        there: whether it can be opened.
    """

    def __init__(self, answer: Answer) -> None:
        self.answer = answer
        self.now_ns = 1_000_000_000
        self.requests: list[tuple[float, bytes]] = []
        self.connections = 0
        self.there = True
        self.coming: list[tuple[int, bytes]] = []
        self.free_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns

    def sleep(self, seconds: float) -> None:
        self.now_ns += max(0, round(seconds * 1e9))

    def tcp(self, host: str, port: int) -> Pipe:
        return self.serial(f"{host}:{port}")

    def serial(self, device: str) -> Pipe:
        if not self.there:
            raise DriverIOError(f"{device}: not there")
        self.connections += 1
        return PlayedPipe(device, self)

    def ask(self, request: bytes) -> None:
        self.requests.append((self.now_ns / 1e9, request))
        reply, seconds = self.answer(request)
        self.free_ns = max(self.free_ns, self.now_ns) + round(seconds * 1e9)
        if reply:
            self.coming.append((self.free_ns, reply))
        self.coming.sort()


class PlayedPipe(Pipe):
    def __init__(self, name: str, line: PlayedLine) -> None:
        self.name = name
        self.line = line

    def fileno(self) -> int:
        return -1

    def send(self, protocol: str, data: bytes) -> None:
        self.line.ask(check(protocol, data))

    def recv(self, deadline: float) -> bytes:
        line = self.line
        if not line.coming or line.coming[0][0] > deadline * 1e9:
            line.now_ns = max(line.now_ns, round(deadline * 1e9))
            return b""
        at_ns, data = line.coming.pop(0)
        line.now_ns = max(line.now_ns, at_ns)
        return data

    def _read(self) -> bytes:
        return b""

    def close(self) -> None:
        self.line.coming.clear()


def silent(_: bytes) -> tuple[bytes, float]:
    """Answer nothing."""
    return b"", 0.0


def read_on(driver: Driver, timeout_s: float = 0.2) -> None:
    """Read for ever, until the driver raises; what comes before must be nothing."""
    while not len(driver.read(timeout_s)):
        pass
    raise AssertionError("samples came of a device that delivers none")


@contextmanager
def played(answer: Answer) -> Iterator[PlayedLine]:
    """Let this thread's drivers find the device behind every address."""
    line = PlayedLine(answer)
    with playing(line):
        yield line
