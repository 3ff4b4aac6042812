"""The three ways in which a Modbus device offers samples: a ring of slots, registers to poll, a queue.

Each reader is handed a function that asks for registers and answers with their bytes; it keeps its place over
re-opens, so that a broken connection costs no sample that the device still holds.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from drivers import clock
from drivers.fields import ByteArray, FieldSpec, Layout
from drivers.modbus_codec import Ring, slot_layout, slots_of
from drivers.modbus_frames import FIFO, FIFO_REGISTERS, MAX_REGISTERS, Request
from drivers.modbus_settings import ModbusField, ModbusSettings
from drivers.port import Counts, DriverConfigError, DriverIOError, IntArray, SampleBlock, SourceRequest

Ask = Callable[[Request], ByteArray]
_GATHER_S = 0.02
_HURRY = 0.02
INDEX = "index"


class Reader(ABC):
    """One mode of one source."""

    layout: Layout
    modulus: int | None = None

    def __init__(self, source: SourceRequest, settings: ModbusSettings, counts: Counts, note: Callable[[str], None]):
        self.source = source
        self.settings = settings
        self.counts = counts
        self.note = note
        self.due = 0.0
        self.epoch = 0

    @abstractmethod
    def read(self, ask: Ask, deadline: float) -> SampleBlock:
        """Return what is new, waiting until `deadline` (clock.monotonic) at most."""

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


class RingReader(Reader):
    """Reads a ring: the index, the slots up to it, the index again."""

    def __init__(self, source: SourceRequest, settings: ModbusSettings, counts: Counts, note: Callable[[str], None]):
        super().__init__(source, settings, counts, note)
        if settings.ring is None or settings.index is None:
            raise DriverConfigError(f'{source.name}: mode "ring" needs index and ring')
        self.layout = slot_layout(settings.fields, settings.word_order)
        index = FieldSpec(name=INDEX, type=settings.index.type)
        self._index_layout = Layout((index,), "big", settings.word_order)
        self._index_address = settings.index.address
        self._ring = Ring(settings.ring.address, settings.ring.slots, self.layout.size // 2, index.modulus)
        counted_by_index = source.counter in (None, INDEX)
        self._counter = None if counted_by_index else source.counter
        self.modulus = index.modulus if self._counter is None else self.layout.counter_field(self._counter).modulus
        self._next: int | None = None
        self._seen: int | None = None
        self._pause_s = settings.period_s

    def read(self, ask: Ask, deadline: float) -> SampleBlock:
        while self._seen is None or self._seen == self._next:
            if not self.wait_until_due(deadline):
                return self.empty()
            self._seen = self._follow(self._index(ask))
            self.due = clock.monotonic() + self._pause_s
        return self._fetch(ask, self._seen, deadline)

    def forget_index(self) -> None:
        """Ask for the index anew before the next read: the connection was lost."""
        self._seen = None

    def _request(self, address: int, count: int) -> Request:
        return Request(self.settings.device_id, self.settings.function, address, count)

    def _index(self, ask: Ask) -> int:
        data = ask(self._request(self._index_address, self._index_layout.size // 2))
        return int(self._index_layout.counter(data.reshape(1, -1), INDEX)[0])

    def _follow(self, raw: int) -> int:
        """Return the index unwrapped, and move the place to read from when samples were lost or counting began anew."""
        head = raw if self._next is None else self._ring.unwrap(raw, self._next)
        if self._next is not None and head < self._next:
            head = self._restart(raw)
        oldest = self._ring.oldest(head)
        if self._next is None:
            self._next = oldest
        elif oldest > self._next:
            self.counts.dropped["overrun"] += oldest - self._next
            self._next = oldest
        return head

    def _restart(self, raw: int) -> int:
        self.note(f"the device's index ran back to {raw}: it was restarted; reading goes on with its oldest sample")
        self.counts.faults["restart"] += 1
        self.epoch += 1
        self._next = None
        return raw

    def _fetch(self, ask: Ask, head: int, deadline: float) -> SampleBlock:
        first = end = self._next or 0
        pieces: list[ByteArray] = []
        for span in self._ring.spans(first, head):
            pieces.append(ask(self._request(span.address, span.count)))
            end = span.first + span.samples
            if clock.monotonic() > deadline:
                break
        raw = self._index(ask)
        after = self._ring.unwrap(raw, head)
        if after < head:
            self._seen = self._follow(raw)
            return self.empty()
        return self._deliver(first, end, after, np.concatenate(pieces))

    def _deliver(self, first: int, end: int, after: int, data: ByteArray) -> SampleBlock:
        arrival_ns = clock.monotonic_ns()
        late = self._ring.overtaken(first, end - first, after)
        slots = slots_of(data, self.layout)[~late]
        self.counts.received += end - first
        if late.any():
            self.counts.rejected["overrun"] += int(late.sum())
        self._next = end
        backlog = after - end
        # a device that fills much of its ring between two reads plays faster than in real time: it is not kept waiting
        self._pause_s = self.settings.period_s * (_HURRY if 4 * (end - first) > self._ring.slots else 1.0)
        self._seen = self._follow(after % self._ring.modulus) if backlog >= self._ring.samples_a_request else None
        return SampleBlock(
            self.layout.values(slots, self.source.fields),
            arrival_ns,
            self._count(slots, first, late),
            None,
            self.epoch,
        )

    def _count(self, slots: ByteArray, first: int, late: NDArray[np.bool_]) -> IntArray:
        if self._counter is None:
            return self._ring.raw(first, len(late))[~late]
        return self.layout.counter(slots, self._counter)


class PollReader(Reader):
    """Reads the fields' registers each period: one sample a poll."""

    def __init__(self, source: SourceRequest, settings: ModbusSettings, counts: Counts, note: Callable[[str], None]):
        super().__init__(source, settings, counts, note)
        fields = sorted(settings.fields, key=lambda field: field.address or 0)
        self._requests, places = _poll_plan(fields, settings)
        self.layout = Layout(tuple(fields), "big", settings.word_order)
        self._places = np.array(places)
        self.modulus = self.layout.counter_field(source.counter).modulus if source.counter else None

    def read(self, ask: Ask, deadline: float) -> SampleBlock:
        rows: list[ByteArray] = []
        deadline = min(deadline, max(clock.monotonic(), self.due) + _GATHER_S)
        while self.wait_until_due(deadline):
            rows.append(self._poll(ask))
            self._plan_next()
        if not rows:
            return self.empty()
        slots = np.stack(rows)
        counter = self.layout.counter(slots, self.source.counter) if self.source.counter else None
        return SampleBlock(self.layout.values(slots, self.source.fields), clock.monotonic_ns(), counter)

    def _poll(self, ask: Ask) -> ByteArray:
        self.counts.received += 1
        try:
            data = np.concatenate([ask(request) for request in self._requests])
        except DriverIOError:
            self.counts.rejected["no answer"] += 1
            raise
        sample: ByteArray = data[self._places]
        return sample

    def _plan_next(self) -> None:
        now = clock.monotonic()
        self.due = max(self.due + self.settings.period_s, now) if self.due else now + self.settings.period_s


def _poll_plan(fields: list[ModbusField], settings: ModbusSettings) -> tuple[list[Request], list[int]]:
    """Return the fewest requests without registers between that nobody named, and each byte's place in the answers."""
    requests: list[Request] = []
    places: list[int] = []
    start = end = -1
    asked = 0
    for field in fields:
        address, registers = field.address or 0, (field.size + 1) // 2
        if address > end or address + registers - start > MAX_REGISTERS or start < 0:
            asked += end - start
            start = end = address
            requests.append(Request(settings.device_id, settings.function, start, 0))
        end = max(end, address + registers)
        requests[-1] = Request(settings.device_id, settings.function, start, end - start)
        last = 2 * (asked + address - start + registers)
        places.extend(range(last - field.size, last))
    return requests, places


class FifoReader(Reader):
    """Reads a queue with function 24.

    With a counter field, samples that were seen before are left out (the standard says that reading does not empty
    the queue); without one every reply is taken for new samples.
    """

    def __init__(self, source: SourceRequest, settings: ModbusSettings, counts: Counts, note: Callable[[str], None]):
        super().__init__(source, settings, counts, note)
        self.layout = slot_layout(settings.fields, settings.word_order)
        self._request = Request(settings.device_id, FIFO, settings.address or 0)
        self._full = FIFO_REGISTERS // (self.layout.size // 2)
        self.modulus = self.layout.counter_field(source.counter).modulus if source.counter else None
        self._last: int | None = None

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
            self.note(f"the queue holds {len(data) // 2} registers, no whole number of samples; the last part is left")
        return slots_of(data[: len(data) - rest], self.layout)

    def _new(self, slots: ByteArray) -> ByteArray:
        if self.source.counter is None or self.modulus is None or not len(slots):
            return slots
        counter = self.layout.counter(slots, self.source.counter)
        last, self._last = self._last, int(counter[-1])
        if last is None:
            return slots
        ahead = (counter - last) % self.modulus
        return slots[(ahead > 0) & (ahead < self.modulus // 2)]

    def _block(self, slots: ByteArray) -> SampleBlock:
        counter = self.layout.counter(slots, self.source.counter) if self.source.counter else None
        return SampleBlock(self.layout.values(slots, self.source.fields), clock.monotonic_ns(), counter)


READERS: dict[str, type[Reader]] = {"ring": RingReader, "poll": PollReader, "fifo": FifoReader}
