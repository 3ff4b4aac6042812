"""A Modbus device that keeps its newest samples in a ring of slots, and counts them in an index register."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from drivers import clock
from drivers.fields import ByteArray, FieldSpec, Layout
from drivers.modbus.codec import Ring, slot_layout, slots_of
from drivers.modbus.frames import Request
from drivers.modbus.mode import Ask, Reader
from drivers.modbus.pace import Carried, Pace
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.tuning import FIRST_S, SHARE
from drivers.port import BoolArray, DriverConfigError, IntArray, SampleBlock, SourceRequest

INDEX = "index"


@dataclass
class _Part:
    """Slots that are read and not delivered yet, because the index was not read behind them.

    Attributes:
        first, end: the samples in them: first .. end - 1.
        head: what the index showed before.
        begun: when that was (clock.monotonic).
        good_s: how long good answers took, without what bad, late and missing ones cost.
        broken: whether there were such.
        pieces: the slots' bytes.
    """

    first: int
    head: int
    begun: float
    end: int
    good_s: float = 0.0
    broken: bool = False
    pieces: list[ByteArray] = field(default_factory=list)


class RingReader(Reader):
    """Reads a ring: the index, the slots up to it, the index again.

    Slots that were read before a request failed are kept over that and over a re-open; the index is read
    behind them.

    After a stall reading goes on with the oldest sample that is left; on a link that is too slow for the
    device, near the newest (see `drivers.modbus.pace`).
    """

    def set_up(self, source: SourceRequest, settings: ModbusSettings) -> None:
        if settings.ring is None or settings.index is None:
            raise DriverConfigError(f'{source.name}: mode "ring" needs index and ring')
        self.layout = slot_layout(settings.fields, settings.orders)
        index = FieldSpec(name=INDEX, type=settings.index.type)
        self._index_layout = Layout((index,), *settings.orders)
        self._index_address = settings.index.address
        self._ring = Ring(settings.ring.address, settings.ring.slots, self.layout.size // 2, index.modulus)
        counted_by_index = source.counter in (None, INDEX)
        self._counter = None if counted_by_index else source.counter
        self.modulus = (
            index.modulus if self._counter is None else self.layout.counter_field(self._counter).modulus
        )
        self._next: int | None = None
        self._seen: int | None = None
        self._pause_s = 0.0
        self._asked: tuple[int, float] | None = None
        self._pace = Pace(self._ring)
        self._part: _Part | None = None

    @property
    def most_registers(self) -> int:
        return self._ring.samples_a_request * self._ring.registers

    def read(self, ask: Ask, deadline: float) -> SampleBlock:
        if self._part is not None and self._part.pieces:
            return self._finish(ask, self._part)
        while self._seen is None or self._seen == self._next:
            if not self.wait_until_due(deadline):
                return self.empty()
            self._seen = self._follow(self._index(ask))
            self._plan(self._seen, clock.monotonic())
        return self._fetch(ask, self._seen, deadline)

    def reopened(self) -> None:
        """Ask for the index anew before the next read."""
        self._seen = self._asked = None
        if self._part is not None and not self._part.pieces:
            self._part = None

    @property
    def urgent_at(self) -> float:
        return self.due + self._pause_s

    def _plan(self, head: int, now: float) -> None:
        """Plan when to ask for the index again: after the period, or sooner where the ring fills faster."""
        before, self._asked = self._asked, (head, now)
        if before is None:
            self._pause_s = min(self.settings.period_s, FIRST_S)
        else:
            fills_s = (now - before[1]) * self._ring.slots / SHARE / max(head - before[0], 1)
            self._pause_s = min(self.settings.period_s, fills_s)
        self.due = now + self._pause_s

    def _request(self, address: int, count: int) -> Request:
        return Request(self.settings.device_id, self.settings.function, address, count)

    def _index(self, ask: Ask) -> int:
        data = ask(self._request(self._index_address, self._index_layout.size // 2))
        return int(self._index_layout.counter(data.reshape(1, -1), INDEX)[0])

    def _follow(self, raw: int) -> int:
        """Return the index unwrapped; move the read position when samples were lost or counting restarted."""
        head = raw if self._next is None else self._ring.unwrap(raw, self._next)
        if self._next is not None and head < self._next:
            head = self._restart(raw)
        if self._next is None:
            self._next = self._ring.oldest(head)
        elif self._ring.oldest(head) > self._next:
            self._skip_to(self._pace.resume(head))
        return head

    def _skip_to(self, number: int) -> None:
        """Go on with a later sample; those before it are lost."""
        lost = number - (self._next or 0)
        if lost > 0:
            self.counts.dropped["overrun"] += lost
            self._next = number

    def _restart(self, raw: int) -> int:
        self.note(
            f"the device's index ran back to {raw}: it was restarted; reading goes on with its oldest sample"
        )
        self.counts.faults["restart"] += 1
        self.epoch += 1
        self._next = self._asked = None
        return raw

    def _fetch(self, ask: Ask, head: int, deadline: float) -> SampleBlock:
        first = self._next or 0
        part = self._part = self._part or _Part(first, head, clock.monotonic(), first)
        with self._timed(part):
            for span in self._ring.spans(first, head):
                part.pieces.append(ask(self._request(span.address, span.count)))
                part.end = span.first + span.samples
                if clock.monotonic() > deadline:
                    break
        return self._finish(ask, part)

    @contextmanager
    def _timed(self, part: _Part) -> Iterator[None]:
        """Add to a part's good seconds, whether or not a request fails."""
        begun = clock.monotonic()
        lost_before = self.lost_s
        try:
            yield
        finally:
            lost_s = self.lost_s - lost_before
            part.good_s += max(0.0, clock.monotonic() - begun - lost_s)
            part.broken |= lost_s > 0

    def _finish(self, ask: Ask, part: _Part) -> SampleBlock:
        """Read the index behind a part, and deliver what was not overwritten by then."""
        with self._timed(part):
            raw = self._index(ask)
        self._part = None
        after = self._ring.unwrap(raw, part.head)
        if after < part.head:
            self._seen = self._follow(raw)
            return self.empty()
        late = self._ring.overtaken(part.first, part.end - part.first, after)
        block = self._deliver(part.first, np.concatenate(part.pieces), late)
        self._next = part.end
        if self._pace.behind(late, self._carried(part, after - part.head)):
            self._fall_back(after)
        backlog = after - self._next
        self._seen = (
            self._follow(after % self._ring.modulus) if backlog >= self._ring.samples_a_request else None
        )
        return block

    def _carried(self, part: _Part, written: int) -> Carried:
        seconds = clock.monotonic() - part.begun
        return Carried(part.end - part.first, written, seconds, part.good_s, part.broken)

    def _fall_back(self, head: int) -> None:
        """Leave out what the link is too slow for, and say so."""
        if self._pace.fell_behind():
            self.report("too slow", f"{self.source.name}: {self._pace.carried.words}")
        self._skip_to(self._pace.resume(head))

    def _deliver(self, first: int, data: ByteArray, late: BoolArray) -> SampleBlock:
        """Return the samples from number `first` on but for those too late (n,), and count all of them."""
        arrival_ns = clock.monotonic_ns()
        every = slots_of(data, self.layout)
        slots = every[~late]
        self.counts.received += len(late)
        if late.any():
            self.counts.rejected["overrun"] += int(late.sum())
            self.counts.show_bad("overrun", f"registers {every[late][-1].tobytes().hex(' ', 2)}")
        return SampleBlock(
            self.values(slots),
            arrival_ns,
            self._count(slots, first, late),
            None,
            self.epoch,
        )

    def _count(self, slots: ByteArray, first: int, late: BoolArray) -> IntArray:
        if self._counter is None:
            return self._ring.raw(first, len(late))[~late]
        return self.layout.counter(slots, self._counter)
