"""What the three ways a Modbus device offers samples have in common: rings, registers to poll, queues.

Each reader is handed a function that asks for registers and answers with their bytes; it keeps its place over
re-opens, so that a broken connection costs no sample that the device still holds.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from drivers import clock
from drivers.fields import ByteArray, Layout
from drivers.modbus.frames import Request
from drivers.modbus.settings import ModbusSettings
from drivers.port import Counts, DriverIOError, FloatArray, SampleBlock, SourceRequest, Trace

Ask = Callable[[Request], ByteArray]
"""Asks and answers; raises LaterError, RefusedError and DriverIOError."""


class RefusedError(DriverIOError):
    """The device answered with an exception, whose code this carries."""

    def __init__(self, words: str, code: int) -> None:
        super().__init__(words)
        self.code = code


def _untold(_cause: str, _words: str) -> None:
    """Tell nobody."""


class Reader(ABC):
    """One mode of one source."""

    layout: Layout
    modulus: int | None = None

    def __init__(
        self, source: SourceRequest, settings: ModbusSettings, counts: Counts, note: Callable[[str], None]
    ):
        self.source = source
        self.settings = settings
        self.counts = counts
        self.note = note
        self.report: Callable[[str, str], None] = _untold
        """The driver's own: tells of a state of the line by a cause and words."""
        self.lost_s = 0.0
        """Seconds that requests without a good answer took; the driver counts them."""
        self.due = 0.0
        self.epoch = 0
        self.set_up(source, settings)

    @abstractmethod
    def set_up(self, source: SourceRequest, settings: ModbusSettings) -> None:
        """Make what the mode needs: layout and modulus, and its own place. Raises DriverConfigError."""

    @property
    @abstractmethod
    def most_registers(self) -> int:
        """Registers of the longest answer."""

    @abstractmethod
    def read(self, ask: Ask, deadline: float) -> SampleBlock:
        """Return what is new, waiting until `deadline` (clock.monotonic) at most."""

    @property
    def urgent_at(self) -> float:
        """When the next answer should be there at the latest (clock.monotonic)."""
        return self.due + self.settings.period_s

    def reopened(self) -> None:  # noqa: B027 (most modes keep nothing that a lost connection spoils)
        """Forget what may have changed while there was no connection."""

    def values(self, slots: ByteArray) -> FloatArray:
        """Return the requested fields of samples' registers (n, bytes), (n, m); who looks on sees both."""
        found = self.layout.values(slots, self.source.fields)
        if self.counts.trace is not None:
            shown = [f"registers {slot.tobytes().hex(' ', 2)}" for slot in slots[-Trace.NEWEST :]]
            self.counts.trace.good(shown, found[-Trace.NEWEST :])
        return found

    def wait_until_due(self, deadline: float) -> bool:
        """Wait for the next poll; False when that lies beyond the deadline, which is then reached."""
        now = clock.monotonic()
        until = min(self.due, deadline)
        if until > now:
            clock.sleep(until - now)
        return self.due <= deadline

    def empty(self) -> SampleBlock:
        """Return a block without samples."""
        return SampleBlock(np.empty((0, len(self.source.fields))), clock.monotonic_ns(), epoch=self.epoch)
