"""Faults of devices and lines by name, each for an exact run of samples.

A fault is called `<driver>.<name>`, e.g. serial.garbage; it strikes every source of that driver, or the one
named.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

import numpy as np

from sim_bus.errors import SimUsageError
from sim_bus.rig.fault_names import COUNTERS, FRAMES, KNOWN, NUMBERS, FaultKind, names
from sim_bus.rig.ranges import Runs
from sim_bus.rig.scenario import FaultAt, Scenario
from sim_bus.rig.schedule import first_sample
from sim_bus.tuning import JITTER_SHARE, LINE_NOISE_BYTES, LOSS_SHARE, SHUFFLED_SAMPLES

SENSOR = "sensor"
_BREAK = bytes(32)
_PLAIN = FaultKind("", "")
_NUMBERED = frozenset({*NUMBERS, *COUNTERS})


@dataclass(frozen=True, slots=True)
class Strike:
    """One fault of one source: what, and the samples first .. end − 1 that it strikes."""

    name: str
    first: int
    end: int
    kind: FaultKind = field(default=_PLAIN, compare=False)

    def hits(self, sample: int) -> bool:
        """Tell whether it strikes a sample."""
        return self.first <= sample < self.end


def strikes(scenario: Scenario, driver: str, source: str, sample_rate_hz: float) -> tuple[Strike, ...]:
    """Return the scenario's faults that strike a source."""
    mine = [fault for fault in scenario.fault if _driver(fault) == driver and fault.source in (None, source)]
    return tuple(_strike(fault, sample_rate_hz) for fault in mine)


def check(scenario: Scenario, drivers: Mapping[str, str]) -> None:
    """Raise SimUsageError for a fault that does not exist or that no source (name: driver) can have."""
    wrong = [text for fault in scenario.fault for text in _wrong(fault, drivers)]
    if wrong:
        raise SimUsageError(f"--fault: {text}" for text in wrong)


def _wrong(fault: FaultAt, drivers: Mapping[str, str]) -> Iterator[str]:
    driver = _driver(fault)
    if fault.name not in names():
        yield f'no fault is called "{fault.name}"; {_alike(fault.name, drivers)}'
        return
    if driver == SENSOR:
        if fault.source is not None:
            yield f"{fault.name}: strikes a channel, not a source; say which by channel"
        return
    there = ", ".join(f"{name} ({kind})" for name, kind in drivers.items())
    if driver not in drivers.values():
        yield f"{fault.name}: no source has the driver {driver}; sources are {there}"
    elif fault.source is not None and drivers.get(fault.source) != driver:
        yield f'{fault.name}: no {driver} source is called "{fault.source}"; sources are {there}'
    if fault.channel is not None:
        yield f"{fault.name}: strikes a source, not a channel; say which by source"


def _alike(name: str, drivers: Mapping[str, str]) -> str:
    here = [known for known in names() if known.partition(".")[0] in (*drivers.values(), SENSOR)]
    close = get_close_matches(name, here, 3) or get_close_matches(name, names(), 3)
    like = f"did you mean {' or '.join(close)}? " if close else ""
    return f"{like}deltak sim --list-faults names them all"


def _driver(fault: FaultAt) -> str:
    return fault.name.partition(".")[0]


def _strike(fault: FaultAt, rate: float) -> Strike:
    driver, _, name = fault.name.partition(".")
    kind = KNOWN[driver][name]
    first = first_sample(fault.at_s, rate)
    end = first_sample(fault.at_s + (fault.for_s or kind.lasts_s), rate)
    return Strike(name, first, max(end, first + 1), kind)


class LineFaults:
    """What the faults of one source make of the samples that it sends.

    Args:
        struck: the faults.
        seed: of wrong bits and rubbish.
        text: the line carries text; a wrong bit makes a byte that is none (a wrong digit would be another
            number).

    Attributes:
        strange: makes what a bus sends besides samples, by the fault's name; None where it cannot.
    """

    def __init__(self, struck: Sequence[Strike], seed: int, *, text: bool = False) -> None:
        self.strikes = tuple(struck)
        self.strange: Callable[[str, int, bytes], bytes] | None = None
        self._wrong_bits = (7,) if text else tuple(range(8))
        self._rng = np.random.default_rng([seed, 4])
        self._late: list[bytes] = []
        self._halves = b""
        self._swapped: tuple[int, bytes] | None = None
        self._pool: list[tuple[int, bytes]] = []
        self._newest = -1
        self._gone: set[int] = set()
        self._done = {strike: Runs() for strike in struck}

    def active(self, name: str, sample: int) -> bool:
        """Tell whether a fault strikes at a sample, and note that it did."""
        hit = self._hit(name, sample)
        for strike in hit:
            self._done[strike].add(sample, sample)
        return bool(hit)

    def at_time(self, name: str, sample: int) -> bool:
        """Tell whether a fault timed by clock lasts while `sample` is the newest; it is noted as planned."""
        return bool(self._hit(name, sample))

    def _hit(self, name: str, sample: int) -> list[Strike]:
        return [strike for strike in self.strikes if strike.name == name and strike.hits(sample)]

    def apply(self, sample: int, data: bytes) -> bytes:
        """Return what goes over the line when a sample is due."""
        if not self.strikes:
            return data
        if self._is_lost(sample):
            self._gone.add(sample)
            data = b""
        data = self._strange(sample, self._damaged(sample, data))
        if self.active("stall", sample) or (
            self.active("jitter", sample) and float(self._rng.random()) < JITTER_SHARE
        ):
            self._late.append(data)
            return b""
        late, self._late = b"".join(self._late), []
        return late + self._whole(sample, self._in_order(sample, data))

    def _whole(self, sample: int, data: bytes) -> bytes:
        """Return what is sent now of a sample and of the one before it."""
        earlier, self._halves = self._halves, b""
        if self.active("split", sample):
            data, self._halves = data[: len(data) // 2], data[len(data) // 2 :]
        return earlier + data

    def _is_lost(self, sample: int) -> bool:
        """Tell whether a sample is not sent at all."""
        silent = [self.active(name, sample) for name in ("freeze", "silence", "drop", "restart")]
        unlucky = bool(self._hit("loss", sample)) and float(self._rng.random()) < LOSS_SHARE
        return any(silent) or (unlucky and self.active("loss", sample))

    def _damaged(self, sample: int, data: bytes) -> bytes:
        for name, damage in self._damages.items():
            if data and self.active(name, sample):
                data = damage(data)
                if KNOWN["serial"][name].loses:
                    self._gone.add(sample)
        return data

    @property
    def _damages(self) -> Mapping[str, Callable[[bytes], bytes]]:
        return {
            "corrupt": self._wrong_bit,
            "truncate": lambda data: data[: len(data) // 2],
            "delete": self._without_a_byte,
            "insert": self._with_a_byte,
            "baud": lambda data: self._rng.bytes(len(data)),
            "stolen": self._without_a_part,
            "duplicate": lambda data: data * 2,
            "garbage": lambda data: self._rng.bytes(int(self._rng.integers(*LINE_NOISE_BYTES))) + data,
            "break": lambda data: _BREAK + data,
        }

    def _place(self, data: bytes) -> int:
        return int(self._rng.integers(len(data)))

    def _wrong_bit(self, data: bytes) -> bytes:
        place = self._place(data)
        bit = self._wrong_bits[int(self._rng.integers(len(self._wrong_bits)))]
        return data[:place] + bytes([data[place] ^ 1 << bit]) + data[place + 1 :]

    def _without_a_byte(self, data: bytes) -> bytes:
        place = self._place(data)
        return data[:place] + data[place + 1 :]

    def _without_a_part(self, data: bytes) -> bytes:
        first, last = sorted((self._place(data), self._place(data)))
        return data[:first] + data[last + 1 :]

    def _with_a_byte(self, data: bytes) -> bytes:
        place = 1 + self._place(data[1:])
        return data[:place] + self._rng.bytes(1) + data[place:]

    def _strange(self, sample: int, data: bytes) -> bytes:
        """Return the sample with what the bus sends besides, or instead of it."""
        if self.strange is None:
            return data
        for name in FRAMES:
            if self.active(name, sample):
                data = self.strange(name, self._since(name, sample), data)
                if KNOWN["can"][name].loses:
                    self._gone.add(sample)
        return data

    def _since(self, name: str, sample: int) -> int:
        """Return for how many samples a fault has lasted; negative, how many are left, at its last."""
        strike = self._hit(name, sample)[0]
        return -1 if sample == strike.end - 1 and strike.end > strike.first + 1 else sample - strike.first

    def _in_order(self, sample: int, data: bytes) -> bytes:
        if self.active("shuffle", sample):
            self._pool.append((sample, data))
            return self._shuffled() if len(self._pool) == SHUFFLED_SAMPLES else b""
        ready = self._shuffled() + self._out(sample, data) if self._pool else b""
        earlier, self._swapped = self._swapped, None
        if earlier is None and self.active("reorder", sample):
            self._swapped = (sample, data)
            return ready
        ready = ready or self._out(sample, data)
        if earlier is not None:
            ready += self._out(*earlier)
        return ready

    def _shuffled(self) -> bytes:
        """Return what was held back, in any order."""
        order = self._rng.permutation(len(self._pool))
        pool, self._pool = self._pool, []
        return b"".join(self._out(*pool[place]) for place in order)

    def _out(self, sample: int, data: bytes) -> bytes:
        """Let a sample go; one that a newer one has overtaken is lost to whoever goes by the counter."""
        if data and sample < self._newest:
            self._gone.add(sample)
        self._newest = max(self._newest, sample)
        return data

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Raise SimUsageError where a fault cannot be caused."""
        here = sorted({strike.name for strike in self.strikes} & set(names))
        if here:
            raise SimUsageError(f"--fault: {', '.join(here)}: {why}")

    @property
    def gone(self) -> frozenset[int]:
        """The samples so far that do not arrive whole, or only after newer ones."""
        return frozenset(self._gone)

    @property
    def hidden(self) -> frozenset[int]:
        """The samples that come without a number or a counter of their own."""
        hiding = [strike for strike in self.strikes if strike.name in _NUMBERED and strike.kind.loses]
        return frozenset(number for strike in hiding for number in range(strike.first, strike.end))

    def ledger(self, played: int) -> list[dict[str, Any]]:
        """Return every fault with the samples, among those played, that it struck (or lasted over)."""
        return [
            {"fault": strike.name, "samples": self._struck(strike).before(played)} for strike in self.strikes
        ]

    def _struck(self, strike: Strike) -> Runs:
        planned = Runs()
        planned.add(strike.first, strike.end - 1)
        elsewhere = strike.kind.timed or strike.name in _NUMBERED
        return planned if elsewhere else self._done[strike]
