"""A Modbus device that offers its samples in a queue, function 24."""

from drivers import clock
from drivers.fields import ByteArray
from drivers.modbus.codec import slot_layout, slots_of
from drivers.modbus.frames import FIFO, FIFO_REGISTERS, Request
from drivers.modbus.mode import Ask, Reader
from drivers.modbus.settings import ModbusSettings
from drivers.port import SampleBlock, SourceRequest

_WIDEST = 1 << 62
"""Fixed by 64-bit numbers: a counter of more values wraps with the numbers themselves, beyond which its
modulus lies."""


class FifoReader(Reader):
    """Reads a queue with function 24.

    With a counter field, samples that were seen before are left out (the standard says that reading does not
    empty the queue); without one every reply is taken for new samples.
    """

    def set_up(self, source: SourceRequest, settings: ModbusSettings) -> None:
        self.layout = slot_layout(settings.fields, settings.orders)
        self._request = Request(settings.device_id, FIFO, settings.address or 0)
        self._full = FIFO_REGISTERS // (self.layout.size // 2)
        self.modulus = self.layout.counter_field(source.counter).modulus if source.counter else None
        self._last: int | None = None

    @property
    def most_registers(self) -> int:
        return FIFO_REGISTERS

    def read(self, ask: Ask, deadline: float) -> SampleBlock:
        while self.wait_until_due(deadline):
            slots = self._new(self._whole(ask(self._request)))
            if len(slots) < self._full:
                self.due = clock.monotonic() + self.settings.period_s
            if len(slots):
                self.counts.received += len(slots)
                return self._block(slots)
        return self.empty()

    def _whole(self, data: ByteArray) -> ByteArray:
        rest = len(data) % self.layout.size
        if rest:
            self.counts.faults["queue"] += 1
            self.note(
                f"the queue holds {len(data) // 2} registers, no whole number of samples; "
                "the last part is left"
            )
        return slots_of(data[: len(data) - rest], self.layout)

    def _new(self, slots: ByteArray) -> ByteArray:
        if self.source.counter is None or self.modulus is None or not len(slots):
            return slots
        counter = self.layout.counter(slots, self.source.counter)
        last, self._last = self._last, int(counter[-1])
        if last is None:
            return slots
        ahead = counter - last if self.modulus > _WIDEST else (counter - last) % self.modulus
        return slots[(ahead > 0) & (ahead < self.modulus // 2)]

    def _block(self, slots: ByteArray) -> SampleBlock:
        counter = self.layout.counter(slots, self.source.counter) if self.source.counter else None
        return SampleBlock(self.values(slots), clock.monotonic_ns(), counter)
