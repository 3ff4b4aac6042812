"""The registers of a simulated Modbus device: a ring of slots, single registers to poll, a queue.

A unit is asked before each reply. It brings its registers up to what the clock says, so that a reply is exact
whenever it is asked for and nothing has to wake up in between.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

import numpy as np

from drivers.fields import FieldSpec, Layout
from drivers.modbus.codec import Ring, slot_layout
from drivers.modbus.settings import ModbusSettings
from sim_bus.clock import PlayClock
from sim_bus.devices.device import Bench
from sim_bus.devices.wire import Feed, Raw, WireNumber, split
from sim_bus.errors import SimUsageError
from sim_bus.rig.faults import LineFaults
from sim_bus.rig.ranges import Runs
from sim_bus.tuning import QUEUE_SAMPLES

FIFO_REGISTERS = 31  # fixed by the Modbus application protocol 1.1b3


def registers(data: bytes) -> list[int]:
    """Return bytes as register values."""
    numbers: list[int] = np.frombuffer(data, dtype=">u2").tolist()
    return numbers


_ANSWERED = frozenset({"slow", "dribble", "hang", "hang-up", "half-open", "nan", "range"})
"""Faults during which answers still come; after any other the reader asks again for what it missed."""


class Unit(ABC):
    """One source's device.

    Args:
        source: its name.
        settings: the source's Modbus keys.
        feed: its samples as bytes.
        clock: says how many there are.
        faults: what goes wrong with it.
    """

    def __init__(
        self, source: str, settings: ModbusSettings, feed: Feed, clock: PlayClock, faults: LineFaults
    ) -> None:
        self.source = source
        self.faults = faults
        self.settings = settings
        self.feed = feed
        self.clock = clock
        self.requests = 0
        self.lost = Runs()
        self.set_up()

    @abstractmethod
    def set_up(self) -> None:
        """Make what the mode needs. Raises SimUsageError."""

    @abstractmethod
    def areas(self) -> Iterable[tuple[int, int]]:
        """Return the registers that exist, as (address, count)."""

    @abstractmethod
    def bring_up(self, memory: list[int], start: int, address: int, count: int) -> None:
        """Write into memory (its first register has the address `start`) what a request is about to read."""

    def queue(self, address: int) -> list[int] | None:
        """Return the registers that function 24 answers with; None where there is no queue."""
        return None

    @abstractmethod
    def renew(self) -> None:
        """Forget what the registers hold: they are new and empty."""

    def newest(self) -> int:
        """Return the newest sample by now; -1 before the first."""
        return self.clock.played() - 1 if self.clock.started.is_set() else -1

    def has_fault(self, name: str) -> bool:
        """Tell whether a fault lasts at this time."""
        return self.faults.at_time(name, self.newest())

    def active_faults(self, opened: int = 0) -> frozenset[str]:
        """Return the faults that last now, on a connection made when `opened` was the newest sample."""
        newest = self.newest()
        dead = [strike for strike in self.faults.strikes if strike.name == "half-open"]
        names = {strike.name for strike in self.faults.strikes if strike.hits(newest)} - {"half-open"}
        if any(strike.first <= newest and opened < strike.end for strike in dead):
            names.add("half-open")
        return frozenset(names)

    @property
    def origin(self) -> int:
        """The sample from which the device counts now: 0, or the first after its last restart."""
        restarts = [strike.end for strike in self.faults.strikes if strike.name == "restart"]
        return max((end for end in restarts if end <= self.newest()), default=0)

    def asked(self) -> None:
        """Count a request: the unit has a reader."""
        self.requests += 1
        self.clock.meet(self.source)

    def ledger(self) -> dict[str, Any]:
        """Return what is worth keeping of this unit."""
        played = self.clock.played()
        return {
            "mode": self.settings.mode,
            "requests": self.requests,
            "saturated": self.feed.saturated(played),
            "lost": self.lost.before(played),
            "absent": self._absent(played),
            "faults": self.faults.ledger(played),
        }

    def _absent(self, played: int) -> list[tuple[int, int]]:
        """Return the samples that no reader could get whole."""
        absent = Runs()
        gone = {number for number in self.faults.hidden if number < played} | self.lost.numbers(played)
        absent.add_each(np.array(sorted(gone), dtype=np.int64))
        return absent.before(played)


class RingUnit(Unit):
    """mode "ring": an index, and the newest samples in slots."""

    def set_up(self) -> None:
        source, settings = self.source, self.settings
        if settings.ring is None or settings.index is None:
            raise SimUsageError(f'source "{source}": mode "ring" needs index and ring')
        index = FieldSpec(name="index", type=settings.index.type)
        self._index = Layout((index,), *settings.orders)
        self._index_address = settings.index.address
        layout = slot_layout(settings.fields, settings.orders)
        self._ring = Ring(settings.ring.address, settings.ring.slots, layout.size // 2, index.modulus)
        self._room = (settings.ring.slots - 1) // 2
        if self.clock.fast and self._room < 1:
            raise SimUsageError(f'source "{source}": --fast needs a ring of 3 slots or more')
        self._written = 0
        self._taken = 0

    def areas(self) -> Iterable[tuple[int, int]]:
        yield self._index_address, self._index.size // 2
        yield self._ring.address, self._ring.slots * self._ring.registers

    def bring_up(self, memory: list[int], start: int, address: int, count: int) -> None:
        index_end = self._index_address + self._index.size // 2
        if not self.clock.fast or (address < index_end and self._index_address < address + count):
            self._advance(memory, start)
        self._note_taken(address, count)

    def renew(self) -> None:
        self._written = 0

    def _advance(self, memory: list[int], start: int) -> None:
        head = self.clock.head_for(self.source, self._room)
        origin = self.origin
        if head <= self._written:
            return
        first = max(self._written, head - self._ring.slots, origin)
        size = self._ring.registers
        for number, row in enumerate(self.feed.rows(first, head), first):
            place = self._ring.address - start + self._ring.slot(number - origin) * size
            memory[place : place + size] = registers(row)
        count = np.array([(head - origin) % self._ring.modulus], dtype=self._index.fields[0].dtype)
        place = self._index_address - start
        memory[place : place + self._index.size // 2] = registers(
            self._index.pack({"index": count}).tobytes()
        )
        self._written = head

    def _note_taken(self, address: int, count: int) -> None:
        """Move on past the samples whose whole slots lie in a request, and past those no longer there."""
        origin = self.origin
        oldest = max(self._written - self._ring.slots, origin)
        if self._taken < oldest:
            self.lost.add(self._taken, oldest - 1)
            self._taken = oldest
        if self.active_faults() - _ANSWERED:
            return
        offset = address - self._ring.address
        size = self._ring.registers
        first = -(-offset // size)
        end = (offset + count) // size
        while self._taken < self._written and first <= self._ring.slot(self._taken - origin) < end:
            self._taken += 1
        if self.clock.fast:
            self.clock.take(self.source, self._taken)


class PollUnit(Unit):
    """mode "poll": each field at an address of its own; a request sees the newest sample."""

    def set_up(self) -> None:
        self._fields = self.settings.fields
        self._lowest = min(field.address or 0 for field in self._fields)
        self._stride = max(1, round(self.settings.period_s * self.clock.sample_rate_hz))
        self._shown = -1

    def renew(self) -> None:
        self._shown = -1

    def areas(self) -> Iterable[tuple[int, int]]:
        return [(field.address or 0, (field.size + 1) // 2) for field in self._fields]

    def bring_up(self, memory: list[int], start: int, address: int, count: int) -> None:
        if self.clock.fast and not address <= self._lowest < address + count:
            return
        newest = max(0, self.clock.head_for(self.source, 1) - 1)
        self.clock.take(self.source, newest + self._stride)
        if newest == self._shown:
            return
        self._shown = newest
        row = self.feed.rows(newest, newest + 1)[0]
        for field in self._fields:
            padded = field.size + field.size % 2
            place = (field.address or 0) - start
            memory[place : place + padded // 2] = registers(row[:padded])
            row = row[padded:]


class FifoUnit(Unit):
    """mode "fifo": function 24 takes whole samples from a queue, as many as 31 registers hold."""

    def set_up(self) -> None:
        layout = slot_layout(self.settings.fields, self.settings.orders)
        self._batch = FIFO_REGISTERS // (layout.size // 2)
        self._next = 0

    def areas(self) -> Iterable[tuple[int, int]]:
        return ()

    def renew(self) -> None:
        """A queue lies in no register."""

    def bring_up(self, memory: list[int], start: int, address: int, count: int) -> None:
        """Nothing lies in registers."""

    def queue(self, address: int) -> list[int] | None:
        if address != self.settings.address:
            return None
        head = self.clock.head_for(self.source, self._batch)
        if head - self._next > QUEUE_SAMPLES:
            self.lost.add(self._next, head - QUEUE_SAMPLES - 1)
            self._next = head - QUEUE_SAMPLES
        end = min(head, self._next + self._batch)
        rows = self.feed.rows(self._next, end)
        self._next = end
        self.clock.take(self.source, end)
        return registers(b"".join(rows))


UNREPRESENTABLE = {
    "tcp": ("corrupt",),
    "rtu": (
        "wrong-transaction",
        "wrong-protocol",
        "half-open",
        "black-hole",
        "reset",
        "hang-up",
        "accept-close",
    ),
}
"""Faults that a transport cannot have: TCP mends wrong bits, a serial line has no connections."""
UNITS: dict[str, type[Unit]] = {"ring": RingUnit, "poll": PollUnit, "fifo": FifoUnit}


def make_unit(bench: Bench, number: int, settings: ModbusSettings) -> Unit:
    """Return the device of one Modbus source; SimUsageError when the map names fields that there are not."""
    source = bench.source(number)
    numbers = [
        WireNumber.of_type(field.name, field.type, field.scale, field.offset) for field in settings.fields
    ]
    faults = bench.faults(number)
    faults.refuse(
        UNREPRESENTABLE[settings.transport], f"cannot be caused on Modbus {settings.transport.upper()}"
    )
    if settings.mode != "ring":
        faults.refuse(("restart",), "only a ring begins anew")
    feed = Feed(bench.trajectory_of(number), bench.rig, source, numbers, _packer(settings), faults.strikes)
    return UNITS[settings.mode](source.name, settings, feed, bench.clock_of(number), faults)


def _packer(settings: ModbusSettings) -> "_Packer":
    if settings.mode == "poll":
        return _Packer([Layout((field,), *settings.orders) for field in settings.fields])
    return _Packer([slot_layout(settings.fields, settings.orders)])


class _Packer:
    """Rows of bytes from raw numbers: the layouts one after another, each padded to whole registers.

    A byte alone is the low one of its register.
    """

    def __init__(self, layouts: list[Layout]) -> None:
        self._layouts = layouts

    def __call__(self, raw: Raw) -> list[bytes]:
        parts = []
        for layout in self._layouts:
            slots = layout.pack(raw)
            spare = slots.shape[1] % 2
            front = 0 if layout.byte_order == "little" else spare
            parts.append(np.pad(slots, ((0, 0), (front, spare - front))))
        data = np.hstack(parts)
        return split(data.tobytes(), data.shape[1])
