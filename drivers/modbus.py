"""Modbus over TCP and RTU as a source of samples. Reads only; every reply is held against its request."""

from typing import ClassVar

from drivers import clock
from drivers.fields import ByteArray
from drivers.modbus_frames import ReplyError, Request, RtuFrames, TcpFrames
from drivers.modbus_modes import READERS, Reader, RingReader
from drivers.modbus_settings import ModbusSettings
from drivers.pipe import Pipe, serial_pipe, tcp_pipe
from drivers.port import Driver, DriverIOError, DriverSettings, SampleBlock, SourceRequest
from drivers.serial_port import SerialKeys

_LONGEST = 2048
"""Bytes looked through for a reply; noise before them is forgotten."""


class ModbusDriver(Driver):
    """Samples of a device that speaks Modbus: a ring of slots, polled registers or a queue.

    Raises DriverConfigError when made with fields that the settings do not have. A reply that fails a check, a late
    one and a broken line raise DriverIOError; opened again, the driver goes on where it stopped.
    """

    settings_model: ClassVar[type[DriverSettings]] = ModbusSettings

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self._settings: ModbusSettings = request.settings
        self._reader: Reader = READERS[self._settings.mode](request, self._settings, self.counts, self.note)
        self._resolution = self._reader.layout.resolution(request.fields)
        self.counter_modulus = self._reader.modulus
        self._pipe: Pipe | None = None
        self._frames: TcpFrames | RtuFrames | None = None
        self._opened = False
        self._late_until = 0.0

    def open(self) -> None:
        self.close()
        settings = self._settings
        if settings.transport == "tcp":
            self._frames, self._pipe = TcpFrames(), tcp_pipe(settings.host, int(settings.port), settings.timeout_s)
        else:
            self._frames, self._pipe = RtuFrames(), self._serial()
            self._pipe.drain(max(0.0, self._late_until - clock.monotonic()))
        self.counts.reopened += self._opened
        self._opened = True
        if isinstance(self._reader, RingReader):
            self._reader.forget_index()

    def read(self, timeout_s: float) -> SampleBlock:
        return self._reader.read(self._ask, clock.monotonic() + timeout_s)

    def close(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
        self._pipe = self._frames = None

    def resolution(self) -> tuple[float, ...]:
        return self._resolution

    def _serial(self) -> Pipe:
        settings = self._settings
        keys = SerialKeys(
            port=str(settings.port), baudrate=settings.baudrate, parity=settings.parity, stopbits=settings.stopbits
        )
        return serial_pipe(keys, str(self.request.folder / keys.port))

    def _ask(self, request: Request) -> ByteArray:
        """Return the register bytes that answer a request, by a deadline of its own."""
        if self._pipe is None or self._frames is None:
            raise DriverIOError(f"{self.request.name}: read before open")
        self._pipe.send(self._frames.protocol, self._frames.request(request))
        deadline = clock.monotonic() + self._settings.timeout_s
        try:
            return self._await(self._pipe, self._frames, request, deadline)
        except ReplyError as error:
            self.counts.faults[error.kind] += 1
            raise DriverIOError(f"{self._pipe.name}: {error}") from error

    def _await(self, pipe: Pipe, frames: TcpFrames | RtuFrames, request: Request, deadline: float) -> ByteArray:
        data = b""
        while more := pipe.recv(deadline):
            data = (data + more)[-_LONGEST:]
            answer = frames.reply(data, request)
            if answer is not None:
                return answer
        # a reply that comes later still must not be taken for the next one's: the line is listened out first
        self._late_until = clock.monotonic() + self._settings.timeout_s
        got = f"{len(data)} bytes that are no whole reply" if data else "no reply"
        raise ReplyError("timeout", f"{got} within {self._settings.timeout_s:g} s to {request.words}")
