"""Modbus over TCP and RTU as a source of samples. Reads only; every reply is held against its request."""

from collections.abc import Mapping
from typing import ClassVar

from drivers import clock
from drivers.fields import ByteArray
from drivers.modbus.fifo import FifoReader
from drivers.modbus.frames import BUSY, REFUSED, ReplyError, Request, RtuFrames, TcpFrames
from drivers.modbus.line import ModbusLine, let_go, shared_line
from drivers.modbus.mode import Reader, RefusedError
from drivers.modbus.poll import PollReader
from drivers.modbus.ring import RingReader
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.tuning import BUSY_FIRST_S, BUSY_MOST_S, FASTEST_PACED, PATIENCE, ROUNDING_S
from drivers.modbus.units import LaterError
from drivers.pipe import serial_pipe, tcp_pipe
from drivers.port import Driver, DriverIOError, DriverSettings, SampleBlock, SourceRequest
from drivers.serial_port import SerialKeys, port_hint

READERS: Mapping[str, type[Reader]] = {"ring": RingReader, "poll": PollReader, "fifo": FifoReader}
_REQUEST_BYTES, _ANSWER_BYTES, _BITS_A_BYTE = 8, 5, 11
"""Fixed by Modbus over serial line 1.02: a read request, what a reply has beside its data, bits a byte."""


class ModbusDriver(Driver):
    """Samples of a device that speaks Modbus: a ring of slots, polled registers or a queue.

    Sources on one serial line or one TCP address share its connection. Raises DriverConfigError when made
    with fields that the settings do not have. A request that the device refuses, a broken line and several
    requests in a row without a good answer raise DriverIOError; opened again, the driver goes on where it
    stopped. After a bad reply the device is asked again at once; one that says it is busy, and one that
    missed a request, are asked again later.
    """

    settings_model: ClassVar[type[DriverSettings]] = ModbusSettings
    stamped: ClassVar[bool | None] = False

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self._settings: ModbusSettings = request.settings
        self._reader = READERS[self._settings.mode](request, self._settings, self.counts, self.note)
        self._reader.report = self.report
        self._resolution = self._reader.layout.resolution(request.fields)
        self.counter_modulus = self._reader.modulus
        self._line: ModbusLine | None = None
        self._is_open = False
        self._opened = False
        self._unanswered = 0
        self._not_before = 0.0
        self._busy_s = BUSY_FIRST_S

    def open(self) -> None:
        self.close()
        if self._settings.share:
            self._line = shared_line(self._address(), self._manner(), self._make_line)
        else:
            self._line = self._line or self._make_line()
        self._is_open = True
        self._line.open()
        self.counts.reopened += self._opened
        self._opened = True
        self._reader.reopened()

    def read(self, timeout_s: float) -> SampleBlock:
        now = clock.monotonic()
        if self._not_before > now + ROUNDING_S:
            clock.sleep(min(timeout_s, self._not_before - now))
            return self._reader.empty()
        try:
            return self._reader.read(self._ask, now + timeout_s)
        except LaterError as later:
            self._not_before = later.until
            return self._reader.empty()

    def close(self) -> None:
        """Let go of the line; it is kept in mind, and with it what answers its units owe."""
        if self._line is None or not self._is_open:
            return
        self._is_open = False
        if self._settings.share:
            let_go(self._line)
        else:
            self._line.close()

    def resolution(self) -> tuple[float, ...]:
        return self._resolution

    def hints(self) -> tuple[str, ...]:
        if self._settings.transport == "tcp":
            return ()
        return tuple(
            hint for hint in (port_hint(str(self._settings.port)), self._slow_hint()) if hint is not None
        )

    def _slow_hint(self) -> str | None:
        """Return advice where the longest answer cannot come over the line in time."""
        settings, most = self._settings, self._reader.most_registers
        seconds = (_REQUEST_BYTES + _ANSWER_BYTES + 2 * most) * _BITS_A_BYTE / settings.baudrate
        if seconds < settings.timeout_s:
            return None
        takes = f"an answer of {most} registers takes {seconds:.2g} s at {settings.baudrate} baud"
        return f"{takes}, and has {settings.timeout_s:g} s; raise timeout_s or baudrate"

    def _address(self) -> str:
        settings = self._settings
        return f"{settings.host}:{settings.port}" if settings.transport == "tcp" else self._device()

    def _device(self) -> str:
        return str(self.request.folder / str(self._settings.port))

    def _manner(self) -> str:
        settings = self._settings
        if settings.transport == "tcp":
            return "Modbus TCP"
        return f"{settings.baudrate} baud, parity {settings.parity}, {settings.stopbits} stop bits"

    def _make_line(self) -> ModbusLine:
        settings = self._settings
        if settings.transport == "tcp":
            host = settings.host
            port = int(settings.port)
            timeout_s = settings.timeout_s
            return ModbusLine(lambda: tcp_pipe(host, port, timeout_s), TcpFrames(), None)
        keys = SerialKeys(
            port=str(settings.port),
            baudrate=settings.baudrate,
            parity=settings.parity,
            stopbits=settings.stopbits,
        )
        # the standard: silence of 3.5 characters between frames, and 1.75 ms where that would be shorter
        pause_s = 3.5 * _BITS_A_BYTE / min(settings.baudrate, FASTEST_PACED)
        return ModbusLine(lambda: serial_pipe(keys, self._device()), RtuFrames(), pause_s)

    def _ask(self, request: Request) -> ByteArray:
        """Return the register bytes that answer a request, by a deadline of its own.

        A bad reply is no answer, and what came too soon to be worth waiting for is asked for again at once.
        """
        if self._line is None or not self._is_open:
            raise DriverIOError(f"{self.request.name}: read before open")
        while True:
            begun = clock.monotonic()
            try:
                answer = self._answer(self._line, request)
            except ReplyError as error:
                self._reader.lost_s += clock.monotonic() - begun
                self.counts.faults[error.kind] += 1
                self.counts.show_bad(error.kind, f"{error.data.hex(' ') or 'nothing'}: {error}")
                self._after_failure(error)
            else:
                self._unanswered, self._busy_s = 0, BUSY_FIRST_S
                return answer

    def _answer(self, line: ModbusLine, request: Request) -> ByteArray:
        timeout_s, spare = self._settings.timeout_s, self._settings.gap
        return line.ask(request, timeout_s, self._reader.urgent_at, self.counts.faults, spare)

    def _after_failure(self, error: ReplyError) -> None:
        """Return where the request is to be repeated at once; else raise what the failure comes to."""
        words = f"{self._address()}: {error}"
        if error.code in BUSY:
            until, self._busy_s = clock.monotonic() + self._busy_s, min(2 * self._busy_s, BUSY_MOST_S)
            raise LaterError(until, asked=True)
        if error.code in REFUSED:
            raise _of_kind(RefusedError(words, error.code), error)
        self._unanswered += 1
        if self._unanswered >= PATIENCE:
            raise _of_kind(DriverIOError(f"{words} ({self._unanswered} in a row)"), error)
        if error.silent:
            raise LaterError(clock.monotonic(), asked=True)


def _of_kind(failure: DriverIOError, error: ReplyError) -> DriverIOError:
    failure.kind = error.kind
    failure.__cause__ = error
    return failure
