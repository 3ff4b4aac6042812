"""Modbus registers that show one sample as it is now: polled each period, neighbours in one request."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers import clock
from drivers.fields import ByteArray, Layout
from drivers.modbus.frames import ADDRESS, MAX_REGISTERS, VALUE, Request
from drivers.modbus.mode import Ask, Reader, RefusedError
from drivers.modbus.settings import ModbusField, ModbusSettings
from drivers.modbus.tuning import GATHER_S
from drivers.modbus.units import LaterError
from drivers.port import DriverIOError, SampleBlock, SourceRequest


@dataclass(frozen=True)
class Plan:
    """What to ask for, and where each byte of a sample lies in the answers laid end to end.

    Attributes:
        requests: fewest that cover every field.
        gaps: of each request, the fields' addresses behind registers that nobody named.
        places: of each byte of a sample.
    """

    requests: tuple[Request, ...]
    gaps: tuple[frozenset[int], ...]
    places: tuple[int, ...]


@dataclass(slots=True)
class _Run:
    start: int
    end: int
    gaps: frozenset[int] = frozenset()


def poll_plan(
    fields: Sequence[ModbusField], settings: ModbusSettings, apart: frozenset[int] = frozenset()
) -> Plan:
    """Return the requests for fields, ordered by address.

    Registers between fields are read along when there are `settings.gap` of them or fewer, but for those
    before the addresses in `apart`, which have to be asked for anew.
    """
    runs: list[_Run] = []
    places: list[int] = []
    low_byte_is_first = settings.orders[0] == "little"
    for field in fields:
        address = field.address or 0
        end = address + (field.size + 1) // 2
        _add(runs, address, end, 0 if address in apart else settings.gap)
        last = 2 * (sum(one.end - one.start for one in runs[:-1]) + end - runs[-1].start)
        # a byte alone is the low one of its register
        spare = field.size % 2 if low_byte_is_first else 0
        places.extend(range(last - field.size - spare, last - spare))
    requests = (
        Request(settings.device_id, settings.function, run.start, run.end - run.start) for run in runs
    )
    return Plan(tuple(requests), tuple(run.gaps for run in runs), tuple(places))


def _add(runs: list[_Run], address: int, end: int, gap: int) -> None:
    """Let the last run reach to a field's end, over `gap` registers at most; else begin another."""
    if not runs or not _joins(runs[-1], address, end, gap):
        runs.append(_Run(address, end))
    if address > runs[-1].end:
        runs[-1].gaps |= {address}
    runs[-1].end = max(runs[-1].end, end)


def _joins(run: _Run, address: int, end: int, gap: int) -> bool:
    return address - run.end <= gap and max(run.end, end) - run.start <= MAX_REGISTERS


class PollReader(Reader):
    """Reads the fields' registers each period: one sample a poll.

    A device that refuses a request with registers in it that nobody named is asked for them apart from then
    on.
    """

    def set_up(self, source: SourceRequest, settings: ModbusSettings) -> None:
        self._fields = sorted(settings.fields, key=lambda field: field.address or 0)
        self._apart: frozenset[int] = frozenset()
        self._plan = poll_plan(self._fields, settings)
        self._failure: LaterError | DriverIOError | None = None
        self.layout = Layout(tuple(self._fields), *settings.orders, apart=True)
        self.modulus = self.layout.counter_field(source.counter).modulus if source.counter else None

    @property
    def most_registers(self) -> int:
        return max(request.count for request in self._plan.requests)

    def read(self, ask: Ask, deadline: float) -> SampleBlock:
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure
        rows = list(self._rows(ask, min(deadline, max(clock.monotonic(), self.due) + GATHER_S)))
        if not rows:
            return self.empty()
        slots = np.stack([sample for sample, _ in rows])
        received = np.array([time_ns for _, time_ns in rows], dtype=np.int64)
        counter = self.layout.counter(slots, self.source.counter) if self.source.counter else None
        values = self.values(slots)
        return SampleBlock(values, clock.monotonic_ns(), counter, received_ns=received)

    def _rows(self, ask: Ask, deadline: float) -> Iterator[tuple[ByteArray, int]]:
        """Poll until the deadline, with each answer's time; a later failure is kept for the next read."""
        some = False
        while self.wait_until_due(deadline):
            try:
                yield self._poll(ask), clock.monotonic_ns()
            except (LaterError, DriverIOError) as failure:
                if not some:
                    raise
                self._failure = failure
                return
            some = True

    def _poll(self, ask: Ask) -> ByteArray:
        """Return one sample; a poll for which the line had no time yet stays due."""
        try:
            data = self._answers(ask)
        except (LaterError, DriverIOError) as failure:
            if not isinstance(failure, LaterError) or failure.asked:
                self.counts.rejected["no answer"] += 1
                self._polled()
            raise
        self._polled()
        sample: ByteArray = data[list(self._plan.places)]
        return sample

    def _polled(self) -> None:
        self.counts.received += 1
        self._plan_next()

    def _answers(self, ask: Ask) -> ByteArray:
        answers: list[ByteArray] = []
        while len(answers) < len(self._plan.requests):
            number = len(answers)
            try:
                answers.append(ask(self._plan.requests[number]))
            except RefusedError as refusal:
                if not self._split(number, refusal.code):
                    raise
        return np.concatenate(answers)

    def _split(self, number: int, code: int) -> bool:
        """Ask apart from now on for what a refused request read along; False where it read nothing along."""
        request, gaps = self._plan.requests[number], self._plan.gaps[number]
        if code not in {ADDRESS, VALUE} or not gaps:
            return False
        self.note(
            f"the device refuses {request.words} (exception {code}): the gaps in it are left out from now on"
        )
        self.counts.faults["gap refused"] += 1
        self._apart |= gaps
        self._plan = poll_plan(self._fields, self.settings, self._apart)
        return True

    def _plan_next(self) -> None:
        now = clock.monotonic()
        self.due = max(self.due + self.settings.period_s, now) if self.due else now + self.settings.period_s
