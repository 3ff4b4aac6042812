"""Where CAN frames come from: a socketcand daemon, or any bus python-can speaks to; can_kernel and can_slcan.

Each bus is read by one thread in a loop of its own. Nothing is ever sent but a listed handshake.
"""

import os
import re
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from drivers import clock
from drivers.can.codec.frames import (
    ERROR,
    EXTENDED,
    FD_FLAG,
    REMOTE,
    DaemonText,
    Frames,
    frames_of,
    no_frames,
    pack_frame,
)
from drivers.can.codec.python_can import import_lean
from drivers.can.tuning import CONNECT_S, READ_FRAMES
from drivers.pipe import tcp_pipe
from drivers.port import Counts, DriverConfigError, DriverIOError, DriverSettings

if TYPE_CHECKING:
    import can


Filters = tuple[tuple[int, int], ...]
"""(number, mask) each: frames whose identifier, flag bits included, equals number within mask are wanted."""


def _known_form(interface: str) -> str:
    if not re.fullmatch("[a-z][a-z0-9_]*", interface):
        raise ValueError('must be the name of an interface, such as "socketcan"')
    return interface


class BusKeys(DriverSettings):
    """Which bus to listen to."""

    interface: Annotated[str, AfterValidator(_known_form)]
    channel: str = Field(min_length=1, max_length=255)
    host: str = "127.0.0.1"
    port: int = Field(default=29536, gt=0, lt=65536)
    bitrate: int | None = Field(default=None, gt=0)
    fd: bool = False
    baudrate: int = Field(default=115200, gt=0)
    open_adapter: bool = False


class CanBus(ABC):
    """An open bus. Frames that the bus says it lost are added to counts.dropped.

    Attributes:
        gather_s: for so long it surely has room for what comes.
    """

    gather_s: ClassVar[float] = 0.05

    @abstractmethod
    def frames(self, deadline: float) -> Frames:
        """Return what came, waiting until `deadline` (clock.monotonic); DriverIOError if the bus is gone."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the bus; harmless when let go already."""


class DaemonBus(CanBus):
    """socketcand over TCP, in raw mode."""

    def __init__(self, keys: BusKeys, counts: Counts) -> None:
        self._counts = counts
        self._pipe = tcp_pipe(keys.host, keys.port, CONNECT_S)
        self._text = DaemonText()
        self._channel = keys.channel
        try:
            self._expect(b"< hi >", b"")
            self._expect(b"< ok >", b"< open %s >" % keys.channel.encode())
            self._expect(b"< ok >", b"< rawmode >")
        except DriverIOError:
            self._pipe.close()
            raise

    def _expect(self, answer: bytes, command: bytes) -> None:
        if command:
            self._pipe.send("socketcand", command)
        deadline = clock.monotonic() + CONNECT_S
        got = b""
        while answer not in got:
            more = self._pipe.recv(deadline)
            got += more
            # frames may come right behind the answer, more of them than an answer would ever have bytes
            if answer not in got and (not more or b"< error" in got or len(got) > 4096):
                raise DriverIOError(
                    f"{self._pipe.name}: socketcand answers {got[:80]!r} to "
                    f"{command.decode() or 'the connection'}; does it serve {self._channel}?"
                )
        self._keep_frames(got.partition(answer)[2])

    def _keep_frames(self, rest: bytes) -> None:
        """Keep frames that came right behind an answer."""
        self._early = rest

    def frames(self, deadline: float) -> Frames:
        early, self._early = self._early, b""
        data = early + self._pipe.recv(clock.monotonic() if early else deadline)
        bad = self._text.bad
        frames = self._text.feed(data) if data else no_frames()
        if self._text.bad > bad:
            self._counts.received += self._text.bad - bad
            self._counts.rejected["text"] += self._text.bad - bad
            self._counts.show_bad("text", self._text.shown)
        return frames

    def close(self) -> None:
        self._pipe.close()


class PythonCanBus(CanBus):
    """Any other interface of python-can.

    The library's filters are not used: with them `recv` says that nothing came when a foreign frame did.
    """

    def __init__(self, keys: BusKeys) -> None:
        import_lean()
        import can

        self._name = f"{keys.interface} {keys.channel}"
        self._errors = (can.CanError, OSError, ValueError)
        extra: dict[str, Any] = {"fd": keys.fd, **({"bitrate": keys.bitrate} if keys.bitrate else {})}
        try:
            self._bus: can.BusABC = can.Bus(keys.channel, keys.interface, **extra)
        except can.CanInterfaceNotImplementedError as error:
            raise DriverConfigError(
                f'python-can has no interface "{keys.interface}" here: {error}'
            ) from error
        except self._errors as error:
            raise DriverIOError(f"{self._name}: {error}") from error

    def frames(self, deadline: float) -> Frames:
        rows: list[bytes] = []
        times: list[float] = []
        wait = max(0.0, deadline - clock.monotonic())
        try:
            while len(rows) < READ_FRAMES and (message := self._bus.recv(0.0 if rows else wait)) is not None:
                rows.append(message_row(message))
                times.append(message.timestamp)
        except self._errors as error:
            raise DriverIOError(f"{self._name}: {error}") from error
        return frames_of(rows, np.rint(np.array(times) * 1e9).astype(np.int64)) if rows else no_frames()

    def close(self) -> None:
        try:
            self._bus.shutdown()
        except self._errors:
            os.sched_yield()  # a bus that is gone cannot be shut down: nothing is left to release


def message_row(message: "can.Message") -> bytes:
    """Return a message of python-can as a row of a frame table."""
    bits = (
        (EXTENDED, message.is_extended_id),
        (REMOTE, message.is_remote_frame),
        (ERROR, message.is_error_frame),
    )
    number = message.arbitration_id | sum(bit for bit, is_set in bits if is_set)
    data = b"" if message.is_remote_frame else bytes(message.data[:64])
    # a log that was cut within a frame: what is missing of it is not zero
    length = min(message.dlc, 64 if message.is_remote_frame else len(data))
    return pack_frame(number & 0xFFFFFFFF, data, FD_FLAG if message.is_fd else 0, length)
